"""Driving the learner by hand in the page, with keys and with touch, in headless Chromium."""

from typing import Any

import numpy as np
import pytest
from conftest import Open
from page_in_browser import MINUS, PHONE, compare, until

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
    opened = open_drive(open_page, page_server)
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
