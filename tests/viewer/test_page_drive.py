"""Driving the learner by hand in the page, with keys and with touch: in a run's corridor, and against its policy."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from conftest import Open, in_each_browser
from eventful import eventful
from page_in_browser import MINUS, PHONE, compare, settle, shown, tap, until
from recorded_run import begun_run, settings

from trainer.runs.trajectories import save_trajectories
from trainer.viewer.page_server import PageServer


def wanted(opened: Any) -> tuple[str | None, float, float]:
    """How the episode ended, or where somebody who knows the way would steer: switch, round the opponent, target."""
    outcome, goal, now, before = opened.evaluate(
        """(() => {
            const track = corridor.stage.track;
            const row = (r) => Object.fromEntries([...track.columns].map(([name, values]) => [name, values[r]]));
            return [track.outcome, track.goal, row(track.rows - 1), row(Math.max(track.rows - 2, 0))];
        })()"""
    )
    x, z, ox, oz = (10 * now[name] for name in ("p_x", "p_z", "op0_x", "op0_z"))
    vx, vz = 100 * (now["p_x"] - before["p_x"]), 100 * (now["p_z"] - before["p_z"])
    if now["switch"] < 0.5:
        to = (0.0, 3.0)
    elif x < ox + 2:
        to = (9.0, 4.0 if oz < 1.5 else -2.0)
    else:
        to = goal
    return outcome, to[0] - x - 0.5 * vx, to[1] - z - 0.5 * vz


def open_drive(open_page: Open, page_server: PageServer, **options: Any) -> Any:
    opened = open_page(page_server.address, **options)
    opened.click("[data-tab=drive]")
    until(opened, "document.querySelector('#drive-result').innerText.includes('first move')")
    return opened


def reached(opened: Any) -> None:
    until(opened, "document.querySelector('#drive-result').innerText.startsWith('Target reached.')")
    total = opened.evaluate("corridor.stage.track.returns.at(-1)")
    seconds = opened.evaluate("corridor.stage.end") / 10
    assert opened.inner_text("#drive-result").endswith(f"Return {total:.3f} in {seconds:.1f} s.".replace("-", MINUS))
    assert opened.locator("#accrued .now").inner_text().startswith("target reached")
    cells = opened.locator("#accrued tr td:last-child").all_inner_texts()
    sums = [float(text.replace(MINUS, "-")) for text in cells if text]
    assert sums[-1] == pytest.approx(sum(sums[:-1]), abs=0.003)


@pytest.mark.slow
def test_keys_drive_the_learner_to_the_target(open_page, page_server):
    opened = open_drive(open_page, page_server, in_3d=True)
    down: set[str] = set()
    for _ in range(2000):
        outcome, x, z = wanted(opened)
        if outcome:
            break
        keys = {"ArrowRight" if x > 0 else "ArrowLeft"} if abs(x) > 0.3 else set()
        keys |= {"ArrowUp" if z > 0 else "ArrowDown"} if abs(z) > 0.3 else set()
        for key in down - keys:
            opened.keyboard.up(key)
        for key in keys - down:
            opened.keyboard.down(key)
        down = keys
        opened.wait_for_timeout(30)
    reached(opened)
    compare(opened, "drive")
    for key in down:
        opened.keyboard.up(key)
    opened.keyboard.press("r")
    until(opened, "corridor.stage.track.rows === 1")


@pytest.mark.slow
def test_touch_drives_the_learner_to_the_target(open_page, page_server):
    opened = open_drive(open_page, page_server, viewport=PHONE, has_touch=True, is_mobile=True)
    opened.locator("#joystick").scroll_into_view_if_needed()
    box = opened.locator("#joystick").bounding_box()
    centre, reach = (box["x"] + box["width"] / 2, box["y"] + box["height"] / 2), box["width"] / 2 - 20
    touch = opened.context.new_cdp_session(opened)

    def send(kind: str, x: float = 0.0, z: float = 0.0) -> None:
        point = {"x": centre[0] + reach * x, "y": centre[1] - reach * z}
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": [] if kind == "touchEnd" else [point]})

    send("touchStart")
    for _ in range(2000):
        outcome, x, z = wanted(opened)
        if outcome:
            break
        send("touchMove", float(np.clip(x, -1, 1)), float(np.clip(z, -1, 1)))
        opened.wait_for_timeout(30)
    send("touchEnd")
    reached(opened)


@in_each_browser
def test_a_runs_own_corridor_is_driven_and_begun_again(open_page, page_server, tmp_path):
    config = dataclasses.replace(settings("wide"), environment_parameters={"goal_x": 4.0, "wall_penalty": 0.5})
    begun_run(config, tmp_path / "results")
    opened = open_page(page_server.address)
    until(opened, "document.querySelector('#runs').innerText.includes('wide')")
    opened.click("[data-tab=drive]")
    until(opened, "corridor.stage.track?.goal[0] === 4")
    assert opened.input_value("#drive-run") == "wide"
    assert f"into a wall\n{MINUS}0.5" in opened.inner_text("#accrued")
    assert opened.evaluate("document.activeElement.id") == "joystick"
    begin = "[...corridor.stage.track.columns].map(([name, values]) => values[0])"
    first = opened.evaluate(begin)
    opened.keyboard.down("ArrowUp")
    until(opened, "corridor.stage.track.rows > 3")
    opened.keyboard.up("ArrowUp")
    opened.keyboard.press("r")  # the same start
    until(opened, "corridor.stage.track.rows === 1")
    assert opened.evaluate(begin) == first
    opened.keyboard.press("n")  # another one
    until(opened, f"JSON.stringify({begin}) !== JSON.stringify({first})")
    opened.select_option("#drive-run", "")
    until(opened, "corridor.stage.track.goal[0] === 9")


@pytest.mark.slow
@in_each_browser
def test_an_episode_of_the_evaluation_is_there_to_be_beaten(open_page, page_server, tmp_path):
    config, trajectories = eventful("bad")
    save_trajectories(begun_run(config, tmp_path / "results").trajectories, trajectories)
    episode = trajectories.episodes[1]
    total = f"{episode.rewards.sum():.3f}".replace("-", MINUS)
    opened = open_page(f"{page_server.address}#run=bad&episode=1&t=2", has_touch=True)
    shown(opened, 1)
    until(opened, "!document.querySelector('#beat').disabled")
    opened.focus("#beat")
    opened.keyboard.press("Enter")
    until(opened, "document.querySelector('#drive-result').innerText.includes('beat it')")
    assert f"The policy's return was {total}" in opened.inner_text("#drive-result")
    assert opened.inner_text("#drive-title") == "You drive episode 1"
    assert opened.evaluate("corridor.stage.ghost.rows") == len(episode.observations)
    for name, index in (("p_x", 0), ("p_z", 1), ("op0_x", 8), ("op0_z", 9)):
        start = opened.evaluate(f"corridor.stage.track.at('{name}', 0)")
        assert start == episode.observations[0, index]
    opened.keyboard.down("ArrowLeft")  # into the wall, ten times a second
    until(opened, "document.querySelector('#drive-result').innerText.startsWith('Failed.')")
    opened.keyboard.up("ArrowLeft")
    mine = opened.evaluate("corridor.stage.track.returns.at(-1)")
    assert mine > episode.rewards.sum()
    assert opened.inner_text("#drive-result").endswith(
        f"the policy's {total} in {len(episode.rewards) / 10:.1f} s is beaten."
    )
    tap(opened, "#again")
    until(opened, "corridor.stage.track.rows === 1")
    assert opened.evaluate("corridor.stage.track.at('p_x', 0)") == episode.observations[0, 0]
    opened.click("[data-tab=episodes]")
    shown(opened, 1)
    assert opened.evaluate("corridor.stage.ghost") is None


@in_each_browser
def test_on_a_phone_a_view_the_pad_and_a_restart_fit_one_screen(open_page, page_server, tmp_path):
    config, trajectories = eventful("bad")
    save_trajectories(begun_run(config, tmp_path / "results").trajectories, trajectories)
    opened = open_page(f"{page_server.address}#run=bad&episode=1&t=2", viewport=PHONE, has_touch=True)
    shown(opened, 1)
    until(opened, "!document.querySelector('#beat').disabled")
    tap(opened, "#beat")
    until(opened, "document.querySelector('#drive-result').innerText.includes('beat it')")
    settle(opened)
    assert opened.evaluate("scrollY") == 0
    for selector in ("#tabs", "#canvas-top", "#readout", "#joystick", "#again", "#new-episode", "#drive-result"):
        box = opened.locator(selector).bounding_box()
        for side, size in (("x", "width"), ("y", "height")):
            assert 0 <= box[side] <= box[side] + box[size] <= PHONE[size], selector
    assert not opened.is_visible("#view3d")
    assert opened.locator("#canvas-top").bounding_box()["width"] > 350


def test_a_corridor_that_cant_be_driven_is_one_sentence(open_page, page_server, tmp_path):
    folder = begun_run(settings("walker"), tmp_path / "results")
    folder.configuration.write_text(folder.configuration.read_text() + "\nbehavior: {name: Walker}\n")
    opened = open_page(page_server.address)
    until(opened, "document.querySelector('#runs').innerText.includes('walker')")
    opened.click("[data-tab=drive]")
    until(opened, "document.querySelector('#notes').innerText.includes('only a corridor can be driven')")
