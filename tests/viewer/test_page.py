"""The page in a real browser: headless Chromium, driven by Playwright, with WebGL in software."""

import dataclasses
import io
import json
import os
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import BIN, CHROMIUM, CHROMIUM_FLAGS, DESKTOP, Open
from PIL import Image
from recorded_run import GOLDEN, recorded_run, settings

from trainer.runs.trajectories import load_trajectories
from trainer.viewer.document import PAGE, page
from trainer.viewer.page_server import PageServer
from trainer.viewer.scene import run_scene

PHONE = {"width": 390, "height": 844}
CONFIG = settings()
# Baselines are compared at a quarter of their size; text is drawn differently from machine to machine.
CHANNEL_TOLERANCE, SHARE_TOLERANCE = 30, 0.02
VIEW_TOLERANCE = 0.002  # of a view alone, which has hardly any text

MINUS = "\N{MINUS SIGN}"


@pytest.fixture(scope="module")
def scene() -> dict[str, Any]:
    return run_scene(CONFIG, load_trajectories(GOLDEN / "trajectories.npz"))


@pytest.fixture(scope="module")
def replay(scene: dict[str, Any], tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "replay.html"
    path.write_text(page({"mode": "replay", "scene": scene}), encoding="utf-8")
    return path.as_uri()


@pytest.fixture
def served(tmp_path: Path) -> Iterator[PageServer]:
    server = PageServer(tmp_path / "results", 0, seed=0)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    yield server
    server.shutdown()
    server.server_close()
    thread.join()


def until(opened: Any, condition: str, seconds: float = 120) -> None:
    """Waits; Playwright's own wait evaluates strings in the page, which the page's security policy forbids."""
    for _ in range(round(seconds / 0.05)):
        if opened.evaluate(condition):
            return
        opened.wait_for_timeout(50)
    raise AssertionError(f"it never came to {condition}; the page says {opened.inner_text('body')[:500]}")


def settle(opened: Any) -> None:
    """Waits until what was asked for is drawn."""
    opened.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)))")


def shown(opened: Any, number: int) -> None:
    """Waits until an episode is on the stage."""
    until(opened, f"corridor.list.onStage === {number}")
    settle(opened)


def choose(opened: Any, number: int) -> None:
    opened.click(f"[data-number='{number}']")
    shown(opened, number)


def at(opened: Any, row: int) -> None:
    opened.evaluate(f"corridor.stage.seek({row})")
    settle(opened)


def readout(opened: Any) -> dict[str, str]:
    return dict(
        opened.eval_on_selector_all("#readout div", "all => all.map(d => [...d.children].map(c => c.innerText))")
    )


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
    box = opened.locator(".of-distance .u-over").bounding_box()
    opened.mouse.click(box["x"] + box["width"] / 2, box["y"] + 20)
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
        assert opened.eval_on_selector_all("#episode-list button", numbers) == expected
    opened.click("[data-filter=failures]")
    shown(opened, kinds["failures"][0])
    opened.keyboard.press("ArrowDown")
    shown(opened, kinds["failures"][1])


def test_the_camera_follows_mouse_and_finger_and_comes_back(open_page, replay):
    opened = open_page(replay, has_touch=True)
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


def pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(io.BytesIO(png)).convert("RGB").reduce(4)).astype(int)


def differing(one: np.ndarray, other: np.ndarray) -> float:
    """The share of pixels that differ."""
    assert one.shape == other.shape
    return float((np.abs(one - other).max(axis=-1) > CHANNEL_TOLERANCE).mean())


def compare(opened: Any, name: str, selector: str | None = None) -> None:
    """Holds a screenshot against tests/golden/page/NAME.png; UPDATE_BASELINES=1 writes it anew."""
    baseline = GOLDEN / "page" / f"{name}.png"
    taken = baseline.with_name(f"{name}.taken.png")
    source = opened.locator(selector) if selector else opened
    source.screenshot(path=taken)
    if os.environ.get("UPDATE_BASELINES"):
        Image.open(taken).convert("RGB").quantize(192, dither=Image.Dither.NONE).save(baseline, optimize=True)
        taken.unlink()
        return
    share, tolerance = differing(pixels(baseline.read_bytes()), pixels(taken.read_bytes())), SHARE_TOLERANCE
    if selector:
        tolerance = VIEW_TOLERANCE
    assert share < tolerance, f"{share:.1%} of {name} differs from the baseline: see {taken}"
    taken.unlink()


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
    opened = open_page(replay, **options)
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


def open_drive(open_page: Open, served: PageServer, **options: Any) -> Any:
    opened = open_page(served.address, **options)
    opened.click("[data-tab=drive]")
    until(opened, "document.querySelector('#drive-result').innerText.includes('first move')")
    return opened


def reached(opened: Any) -> None:
    until(opened, "document.querySelector('#drive-result').innerText.startsWith('Target reached.')")
    total = opened.evaluate("corridor.stage.track.returns.at(-1)")
    assert opened.inner_text("#drive-result").endswith(f"Return {total:.3f}.".replace("-", MINUS))
    assert opened.locator("#accrued .now").inner_text().startswith("target reached")
    cells = opened.locator("#accrued tr td:last-child").all_inner_texts()
    sums = [float(text.replace(MINUS, "-")) for text in cells if text]
    assert sums[-1] == pytest.approx(sum(sums[:-1]), abs=0.003)


def test_keys_drive_the_learner_to_the_target(open_page, served):
    opened = open_drive(open_page, served)
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


def test_touch_drives_the_learner_to_the_target(open_page, served):
    opened = open_drive(open_page, served, viewport=PHONE, has_touch=True, is_mobile=True)
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


def start_watching(results: Path, port: int) -> tuple[subprocess.Popen[str], str]:
    command = [BIN / "corridor", "watch", "--results-dir", results, "--port", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "COLUMNS": "500"})
    assert process.stdout
    return process, process.stdout.readline().split()[-1]


def stop(process: subprocess.Popen[str]) -> None:
    process.terminate()
    assert process.wait(30) == 0
    assert process.stdout
    process.stdout.close()


def test_learning_is_followed_and_runs_lie_over_each_other(open_page, tmp_path, free_port):
    results = tmp_path / "results"
    process, address = start_watching(results, free_port)
    opened = open_page(address)
    until(opened, "document.querySelector('#notes').innerText.startsWith('There is no run yet')")
    run = recorded_run(results, "first")
    whole = run.progress.read_text().splitlines(keepends=True)
    run.progress.write_text("".join(whole[:20]))
    opened.wait_for_selector("[data-run=first]:checked")
    facts = opened.locator("#runs li", has_text="first")
    until(opened, "document.querySelectorAll('#curves canvas').length === 5")
    steps = int(whole[19].split(",")[0])
    assert f"{steps:,} steps" in facts.inner_text()
    run.progress.write_text("".join(whole))
    until(opened, f"document.querySelector('#runs').innerText.includes('{int(whole[-1].split(',')[0]):,} steps')")
    second = recorded_run(results, "second", evaluated=False)
    second.progress.write_text("".join(whole[:30]).replace(",-", ",-0.5"))
    opened.check("[data-run=second]")
    until(opened, "document.querySelectorAll('#runs input:checked').length === 2")
    opened.wait_for_timeout(2500)  # the next look at the files
    opened.mouse.move(5, 5)
    compare(opened, "learning")

    opened.click("[data-tab=episodes]")
    opened.select_option("#episode-run", "first")
    until(opened, "corridor.stage.track?.rows > 1 && corridor.stage.isPlaying")
    assert opened.locator("#episode-list li").count() == 12
    opened.select_option("#episode-run", "second")
    until(opened, "document.querySelector('#notes').innerText.startsWith('No evaluated episode yet')")

    shutil.rmtree(second.path)
    opened.click("[data-tab=learning]")
    gone = opened.locator("#runs li", has_text="second")
    until(opened, "document.querySelector('#runs').innerText.includes('folder is gone')")
    assert "gone" in gone.inner_text()
    stop(process)
    until(opened, "document.querySelector('#notes').innerText.includes('does not answer')")
    assert opened.locator("#curves canvas").count() == 5  # what was read stays
    process, _ = start_watching(results, free_port)
    until(opened, "document.querySelector('#notes').innerText.includes('open the address that it printed')")
    stop(process)


def test_the_bundle_is_built_from_its_sources(tmp_path):
    if shutil.which("npm") is None:
        pytest.skip("Node is not installed")
    sources = tmp_path / "page"
    shutil.copytree(PAGE.parent, sources, ignore=shutil.ignore_patterns("node_modules"))
    installed = subprocess.run(["npm", "ci", "--ignore-scripts"], cwd=sources, capture_output=True, text=True)
    if installed.returncode:
        pytest.skip(f"npm can't install the bundler: {installed.stderr[-200:]}")
    subprocess.run(["npm", "run", "build"], cwd=sources, check=True, capture_output=True)
    assert (sources / "page.html").read_bytes() == PAGE.read_bytes(), "run 'make page'"
