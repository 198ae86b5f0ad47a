"""The page that shows one run, in a real browser: headless Chromium, driven by Playwright, with WebGL in software."""

import dataclasses
import json
import threading
from typing import Any

import numpy as np
import pytest
from conftest import CHROMIUM, CHROMIUM_FLAGS, DESKTOP
from page_in_browser import (
    MINUS,
    PHONE,
    SHARE_TOLERANCE,
    at,
    choose,
    compare,
    differing,
    pixels,
    readout,
    settle,
    shown,
    until,
)
from recorded_run import GOLDEN, settings

from trainer.runs.trajectories import load_trajectories
from trainer.viewer.corridor_scene import run_scene
from trainer.viewer.document import page

CONFIG = settings()


@pytest.fixture(scope="module")
def scene() -> dict[str, Any]:
    return run_scene(CONFIG, load_trajectories(GOLDEN / "trajectories.npz"))


@pytest.fixture(scope="module")
def replay(scene: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "replay.html"
    path.write_text(page({"mode": "replay", "scene": scene}), encoding="utf-8")
    return path.as_uri()


def test_it_plays_to_the_end(open_page, replay, scene):
    opened = open_page(replay)
    first = max(scene["episodes"], key=lambda record: (record["outcome"] == "goal", -record["closest"]))
    shown(opened, first["number"])
    assert opened.inner_text("#subtitle") == "fast · ppo, c = 0.3, seed 0, built-in player"
    opened.select_option("#speed", "8")
    opened.click("#play")
    until(opened, "document.querySelector('#clock').innerText.includes('target reached')")
    seconds = first["length"] / 10
    assert opened.inner_text("#clock").startswith(f"{seconds:.1f} / {seconds:.1f} s")
    assert readout(opened)["return so far"] == f"{first['return']:.3f}"
    assert readout(opened)["eq. 9 says"] == "target reached, switch on"
    opened.keyboard.press("Space")  # again from the start
    until(opened, "corridor.stage.isPlaying && corridor.stage.time > 3")
    opened.keyboard.press("Space")
    assert not opened.evaluate("corridor.stage.isPlaying")


def test_every_number_is_the_recorded_one(open_page, replay):
    recorded = load_trajectories(GOLDEN / "trajectories.npz").episodes
    opened = open_page(replay)
    for number, episode in enumerate(recorded):
        choose(opened, number)
        columns = opened.evaluate(
            "Object.fromEntries([...corridor.stage.track.columns].map(([name, values]) => [name, [...values]]))"
        )
        expected = {
            "p_x": episode.observations[:, 0],
            "p_z": episode.observations[:, 1],
            "switch": episode.observations[:, 7],
            "op0_x": episode.observations[:, 8],
            "op0_z": episode.observations[:, 9],
            "op0_d": episode.observations[:, 10],
            "reward": np.concatenate([[0], episode.rewards]),
            "a_x": np.concatenate([[0], episode.actions[:, 0]]),
            "a_z": np.concatenate([[0], episode.actions[:, 1]]),
        }
        assert columns.keys() == expected.keys()
        for name, values in expected.items():
            assert columns[name] == values.astype(float).tolist(), name
        assert opened.evaluate("corridor.stage.track.outcome") == ("goal" if episode.succeeded else "failed")


def test_scrubbing_and_stepping_show_that_decision(open_page, replay):
    episodes = load_trajectories(GOLDEN / "trajectories.npz").episodes
    failed = next(row for row, episode in enumerate(episodes) if not episode.succeeded)
    episode = episodes[failed]
    opened = open_page(replay)
    choose(opened, failed)
    last = len(episode.rewards)
    for key, row in [("End", last), ("ArrowLeft", last - 1), ("Shift+ArrowLeft", last - 11), ("ArrowRight", last - 10)]:
        opened.keyboard.press(key)
        settle(opened)
        reward = episode.rewards[row - 1]
        assert readout(opened)["reward"] == f"{reward:.3f}".replace("-", MINUS)
        assert readout(opened)["d_opp"] == f"{episode.observations[row, 10]:.3f}"
    opened.keyboard.press("End")
    settle(opened)
    assert f"failed: {MINUS}1 more" in readout(opened)["eq. 9 says"]
    opened.fill("#scrub", "10")
    settle(opened)
    assert opened.inner_text("#clock").startswith("1.0 /")
    chart = opened.locator(".of-distance .u-over")
    chart.scroll_into_view_if_needed()
    box = chart.bounding_box()
    chart.click(position={"x": box["width"] / 2, "y": 20})
    settle(opened)
    time = opened.evaluate("corridor.stage.time")
    assert time == pytest.approx(last / 2, abs=2)
    head = opened.locator(".of-distance .head").bounding_box()
    assert head["x"] == pytest.approx(box["x"] + box["width"] * time / last, abs=4)


def test_episodes_are_chosen_by_kind(open_page, replay, scene):
    opened = open_page(replay)
    numbers = "all => all.map(button => Number(button.dataset.number))"
    kinds = {
        "successes": [r["number"] for r in scene["episodes"] if r["outcome"] == "goal"],
        "failures": [r["number"] for r in scene["episodes"] if r["outcome"] == "failed"],
        "closest": [r["number"] for r in sorted(scene["episodes"], key=lambda r: r["closest"])],
    }
    assert all(len(numbers) > 1 for numbers in kinds.values())
    for kind, expected in kinds.items():
        opened.click(f"[data-filter={kind}]")
        assert opened.eval_on_selector_all("#episode-list [role=option]", numbers) == expected
    opened.click("[data-filter=failures]")
    shown(opened, kinds["failures"][0])
    opened.keyboard.press("ArrowDown")
    shown(opened, kinds["failures"][1])


def test_the_camera_follows_mouse_and_finger_and_comes_back(open_page, replay):
    opened = open_page(replay, in_3d=True, has_touch=True)
    choose(opened, 1)
    canvas = opened.locator("#canvas3d")
    before = pixels(canvas.screenshot())
    box = canvas.bounding_box()
    opened.mouse.move(box["x"] + 200, box["y"] + 150)
    opened.mouse.down()
    opened.mouse.move(box["x"] + 260, box["y"] + 130, steps=3)
    opened.mouse.up()
    settle(opened)
    assert differing(pixels(canvas.screenshot()), before) > SHARE_TOLERANCE
    opened.keyboard.press("c")
    settle(opened)
    opened.mouse.move(5, 5)
    assert differing(pixels(canvas.screenshot()), before) < 0.001
    touch = opened.context.new_cdp_session(opened)
    for kind, points in (
        ("touchStart", [(200, 150)]),
        ("touchMove", [(230, 140)]),
        ("touchMove", [(260, 130)]),
        ("touchEnd", []),
    ):
        fingers = [{"x": box["x"] + x, "y": box["y"] + y} for x, y in points]
        touch.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": fingers})
    settle(opened)
    assert differing(pixels(canvas.screenshot()), before) > SHARE_TOLERANCE


@pytest.mark.parametrize(
    ("name", "options", "selector"),
    [
        ("3d", {}, "#view3d"),
        ("top", {}, "#view-top"),
        ("desktop", {}, None),
        ("dark", {"color_scheme": "dark"}, None),
        ("phone", {"viewport": PHONE, "has_touch": True, "is_mobile": True}, None),
    ],
)
def test_it_looks_as_it_did(open_page, replay, name, options, selector):
    opened = open_page(replay, in_3d=True, **options)
    choose(opened, 1)
    at(opened, 150)  # on the way from the switch, past the opponent's zone
    opened.evaluate("scrollTo(0, 0)")
    opened.wait_for_timeout(400)
    width = opened.evaluate("document.documentElement.scrollWidth")
    assert width <= opened.viewport_size["width"]  # nothing to scroll sideways
    compare(opened, name, selector)


def test_without_webgl_there_is_the_top_view(open_page, replay):
    from playwright.sync_api import sync_playwright

    done: list[str] = []

    def look() -> None:  # Playwright has one loop a thread
        with sync_playwright() as playwright:
            plain = playwright.chromium.launch(executable_path=CHROMIUM, args=[*CHROMIUM_FLAGS, "--disable-3d-apis"])
            opened = plain.new_page(viewport=DESKTOP)
            opened.set_default_timeout(120_000)
            opened.goto(replay)
            choose(opened, 1)
            opened.select_option("#speed", "8")
            opened.click("#play")
            until(opened, "document.querySelector('#clock').innerText.includes('target reached')")
            done.append(opened.inner_text("#no-webgl"))
            assert not opened.is_visible("#canvas3d")
            assert opened.locator("#canvas-top").bounding_box()["width"] > 800
            plain.close()

    thread = threading.Thread(target=look)
    thread.start()
    thread.join()
    assert done == ["This browser has no WebGL, so only the top view is shown."]


def test_a_foreign_players_replay_says_what_is_missing(open_page, tmp_path):
    recorded = dataclasses.replace(load_trajectories(GOLDEN / "trajectories.npz"), seed=None)
    (tmp_path / "page.html").write_text(
        page({"mode": "replay", "scene": run_scene(CONFIG, recorded)}), encoding="utf-8"
    )
    opened = open_page((tmp_path / "page.html").as_uri())
    choose(opened, 0)
    at(opened, 100)
    assert "the trainer can't see" in opened.inner_text("#notes")
    assert opened.locator(".legend span:visible").all_inner_texts() == [
        "learner",
        "its target",
        "opponent",
        "near zone",
    ]


def test_broken_data_is_one_sentence(open_page, tmp_path, scene):
    broken = json.loads(json.dumps(scene))
    broken["episodes"][0]["data"] = broken["episodes"][0]["data"][:-400] + "A" * 400
    broken["episodes"][1]["length"] += 1
    (tmp_path / "episode.html").write_text(page({"mode": "replay", "scene": broken}), encoding="utf-8")
    opened = open_page((tmp_path / "episode.html").as_uri())
    for number in (0, 1):
        opened.click(f"[data-number='{number}']")
        until(opened, f"document.querySelector('#notes').innerText.startsWith('Episode {number} is broken')")
    choose(opened, 2)
    whole = page({"mode": "replay", "scene": scene})
    (tmp_path / "page.html").write_text(whole.replace('"scene":', '"scene"'), encoding="utf-8")
    opened = open_page((tmp_path / "page.html").as_uri())
    assert "data is broken" in opened.inner_text("#notes")
