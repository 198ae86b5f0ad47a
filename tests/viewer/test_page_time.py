"""An episode's time line in the page: what it marks, says and remembers, by keyboard and by touch."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import in_each_browser
from eventful import eventful
from page_in_browser import PHONE, at, choose, readout, settle, shown, tap, until
from recorded_run import GOLDEN, settings

from trainer.runs.evaluation import Episode
from trainer.runs.trajectories import load_trajectories
from trainer.viewer.corridor_scene import run_scene
from trainer.viewer.document import page


@pytest.fixture(scope="module")
def replay(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "replay.html"
    path.write_text(page({"mode": "replay", "scene": run_scene(*eventful())}), encoding="utf-8")
    return path.as_uri()


def legend(opened: Any) -> dict[str, str]:
    script = "all => all.map(b => [b.childNodes[1].textContent, b.lastChild.textContent])"
    return dict(opened.eval_on_selector_all("#mark-legend button", script))


def rows_paid(episode: Episode) -> dict[str, list[int]]:
    """Decisions by what eq. 9 paid for them, from the rewards alone."""
    rewards = [reward + (row == len(episode.rewards) - 1) for row, reward in enumerate(episode.rewards.tolist())]
    kinds = {"wall": -0.1, "contact": -0.25}
    found = {
        kind: [row + 1 for row, reward in enumerate(rewards) if abs(reward - paid) < 1e-6]
        for kind, paid in kinds.items()
    }
    return found | {"near": [row + 1 for row, reward in enumerate(rewards) if reward < -0.26]}


def places(opened: Any, mark: str) -> list[tuple[float, float]]:
    """Where a mark's pieces begin and end, as shares of the time line."""
    return opened.eval_on_selector_all(
        f"#marks .at-{mark}",
        "all => all.map(i => [i.style.left, i.style.width].map(t => parseFloat(t || '0') / 100))"
        ".map(([left, width]) => [left, left + width])",
    )


@in_each_browser
def test_what_happens_is_marked_and_its_legend_goes_there(open_page, replay):
    episode = eventful()[1].episodes[0]
    opened = open_page(replay, has_touch=True)
    choose(opened, 0)
    paid, end = rows_paid(episode), len(episode.rewards)
    switched = int(np.argmax(episode.observations[:, 7] > 0.5))
    assert legend(opened) == {
        "switch on": f"{switched / 10:.1f} s",
        "end": f"{end / 10:.1f} s",
        **{kind: f"{len(rows) / 10:.1f} s" for kind, rows in paid.items()},
    }
    assert places(opened, "switch") == [pytest.approx((switched / end, switched / end))]
    assert places(opened, "end") == [pytest.approx((1, 1))]
    for kind, rows in paid.items():
        pieces = places(opened, kind)
        covered = [row for begin, to in pieces for row in range(round(begin * end) + 1, round(to * end) + 1)]
        assert covered == rows
    opened.click("[data-mark=wall]")
    settle(opened)
    assert opened.evaluate("corridor.stage.time") == paid["wall"][0]
    assert readout(opened)["eq. 9 says"] == "into a wall"
    opened.focus("[data-mark=near]")
    opened.keyboard.press("Space")  # on a button, what it does there
    settle(opened)
    assert opened.evaluate("corridor.stage.time") == paid["near"][0]
    assert not opened.evaluate("corridor.stage.isPlaying")
    tap(opened, "[data-mark=contact]")
    until(opened, f"corridor.stage.time === {paid['contact'][0]}")
    settle(opened)
    assert readout(opened)["eq. 9 says"] == "touching the opponent"


def test_value_and_curiosity_are_shown_where_they_are_recorded(open_page, replay, tmp_path):
    episode = eventful()[1].episodes[1]
    opened = open_page(replay)
    choose(opened, 1)
    at(opened, 40)
    assert readout(opened)["value"].replace("\N{MINUS SIGN}", "-") == f"{episode.values[40]:.2f}"
    assert readout(opened)["c · r_i"] == f"{episode.intrinsic_rewards[39]:.4f}"
    assert opened.locator("#charts .chart:visible h3 b").all_inner_texts() == [
        "reward",
        "value",
        "c · r_i",
        "d_opp",
        "action",
    ]
    old = tmp_path / "old.html"  # of before they were recorded
    scene = run_scene(settings(), load_trajectories(GOLDEN / "trajectories.npz"), 3)
    old.write_text(page({"mode": "replay", "scene": scene}), encoding="utf-8")
    opened = open_page(old.as_uri())
    until(opened, "corridor.list.onStage !== null")
    assert opened.locator("#charts .chart:visible h3 b").all_inner_texts() == ["reward", "d_opp", "action"]
    assert not opened.is_visible("#readout :text('c · r_i')")


@pytest.mark.parametrize(
    ("step", "expected"),
    [(0.02, ["0.1", "1.0"]), (0.05, ["0.25", "2.50"]), (0.2, ["1", "10"]), (0.025, ["0.125", "1.250"])],
)
def test_times_have_the_digits_that_a_decision_needs(open_page, tmp_path, step, expected):
    config, recorded = eventful()
    config = dataclasses.replace(config, environment_parameters={"fixed_timestep": step})
    path = tmp_path / "replay.html"
    path.write_text(page({"mode": "replay", "scene": run_scene(config, recorded, number=0)}), encoding="utf-8")
    opened = open_page(path.as_uri())
    shown(opened, 0)
    for row, time in zip((1, 10), expected, strict=True):
        at(opened, row)
        assert opened.inner_text("#clock").startswith(f"{time} / ")
        assert opened.get_attribute("#scrub", "aria-valuetext").startswith(f"{time} of ")
    end = f"{len(recorded.episodes[0].rewards) * 5 * step:.3f}"
    assert float(opened.inner_text("#clock").split()[2]) == float(end)


@in_each_browser
def test_it_loops_goes_on_to_the_next_and_follows_the_learner(open_page, replay):
    opened = open_page(replay, in_3d=True, viewport=PHONE, has_touch=True)
    choose(opened, 0)
    opened.select_option("#speed", "8")
    tap(opened, "#loop")
    tap(opened, "#play")
    assert opened.get_attribute("#loop", "aria-pressed") == "true"
    assert opened.get_attribute("#play", "aria-label") == "Pause"
    opened.evaluate("corridor.stage.seek(corridor.stage.end - 5)")
    until(opened, "corridor.stage.isPlaying && corridor.stage.time < 40")
    tap(opened, "#next-episode")
    shown(opened, 1)
    assert opened.evaluate("corridor.stage.isPlaying")  # as before
    opened.keyboard.press("l")
    opened.keyboard.press("n")
    shown(opened, 2)
    opened.keyboard.press("n")  # after the last the first
    shown(opened, 0)
    opened.keyboard.press("End")
    until(opened, "!corridor.stage.isPlaying")
    assert opened.get_attribute("#loop", "aria-pressed") == "false"
    target = "corridor.stage.cameraTarget"
    still = opened.evaluate(target)
    opened.keyboard.press("Home")
    settle(opened)
    assert opened.evaluate(target) == still
    opened.keyboard.press("f")
    for row in (0, 30, 55):
        at(opened, row)
        x, _, z = opened.evaluate(target)
        learner = eventful()[1].episodes[0].observations[row, :2] * 10
        assert (x, -z) == pytest.approx(tuple(learner), abs=0.01)
    assert opened.get_attribute("#follow", "aria-pressed") == "true"
    opened.keyboard.press("c")
    settle(opened)
    assert opened.evaluate(target) == still
    assert opened.get_attribute("#follow", "aria-pressed") == "false"


@pytest.mark.slow
def test_the_address_holds_the_place_and_opening_it_comes_back(open_page, replay):
    opened = open_page(replay)
    choose(opened, 2)
    opened.keyboard.press("ArrowRight")
    opened.keyboard.press("Shift+ArrowRight")
    until(opened, "location.hash === '#run=eventful&episode=2&t=1.1'")
    again = open_page(opened.evaluate("location.href"))
    shown(again, 2)
    assert again.evaluate("corridor.stage.time") == 11
    assert not again.evaluate("corridor.stage.isPlaying")
    again.evaluate("location.hash = '#run=eventful&episode=1&t=3.3'")  # as somebody who edits it, or goes back
    shown(again, 1)
    assert again.evaluate("corridor.stage.time") == 33
    for wrong in ("#run=eventful&episode=99&t=1", "#run=other&episode=1"):
        opened = open_page(replay + wrong)
        until(opened, "corridor.list.onStage !== null")
        place = "episode 99 of eventful" if "99" in wrong else "episode 1 of other"
        assert opened.inner_text("#notes") == f"This page has no {place}; another is shown."
    for broken in ("#run=eventful&episode=1&t=x", "#run=eventful&episode=1&t=1e99", "#episode=1e3", "#%%%"):
        opened = open_page(replay + broken)
        until(opened, "corridor.list.onStage !== null")
        assert 0 <= opened.evaluate("corridor.stage.time") <= opened.evaluate("corridor.stage.end")


@in_each_browser
def test_the_selected_episode_is_seen_and_has_the_focus(open_page, tmp_path: Path):
    scene = run_scene(settings(), load_trajectories(GOLDEN / "trajectories.npz"))
    (tmp_path / "page.html").write_text(page({"mode": "replay", "scene": scene}), encoding="utf-8")
    opened = open_page((tmp_path / "page.html").as_uri() + "#run=fast&episode=11&t=2", viewport=PHONE)
    seen = """(() => {
        const item = document.querySelector('#episode-list [aria-selected=true]').getBoundingClientRect();
        const list = document.querySelector('#episode-list').getBoundingClientRect();
        return item.top >= list.top - 1 && item.bottom <= list.bottom + 1;
    })()"""
    focused = "document.activeElement.dataset.number"
    shown(opened, 11)
    assert opened.evaluate(seen)
    assert opened.evaluate(focused) == "11"
    assert opened.evaluate("scrollY") == 0  # the list moved, the page did not
    for number in (10, 9, 8, 7, 6, 5, 4, 3):
        opened.keyboard.press("ArrowUp")
        shown(opened, number)
    assert opened.evaluate(seen)
    assert opened.evaluate(focused) == "3"
    opened.keyboard.press("Space")
    assert opened.evaluate("corridor.stage.isPlaying")
    opened.keyboard.press("n")
    shown(opened, 4)
    opened.click("[data-filter=failures]")
    assert opened.evaluate(seen)
    assert opened.evaluate("document.activeElement.dataset.filter") == "failures"
    assert opened.eval_on_selector_all("#episode-list [tabindex='0']", "all => all.length") == 1
