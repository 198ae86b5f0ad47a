"""The runs beside the learning curves: which there are, what they gave, and how they differ."""

import dataclasses
import re
import shutil
from typing import Any

import pytest
from axe import violations
from conftest import DESKTOP, in_each_browser
from page_in_browser import settle, until
from recorded_run import GOLDEN, begun_run, recorded_run, settings

from trainer.viewer.document import PAGE

EVALUATION = {
    "episodes": 200,
    "success_rate": 0.97,
    "mean_return": 0.61,
    "mean_episode_length": 228.4,
    "mean_success_length": 231.2,
    "opponent_contact_rate": 0.03,
    "wall_contact_rate": 0.125,
}
FAILED = {**EVALUATION, "success_rate": 0.0, "mean_success_length": None}


@pytest.fixture
def results(tmp_path):
    """A run of its own, and two in a study, of which one is without a success."""
    folder = tmp_path / "results"
    for name, evaluation in (("mine", None), ("penalty/c0.3-seed4", EVALUATION), ("penalty/c0-seed4", FAILED)):
        place, _, run_id = name.rpartition("/")
        config = settings(run_id)
        c = 0.0 if run_id.startswith("c0-") else 0.3
        config = dataclasses.replace(config, curiosity=dataclasses.replace(config.curiosity, c=c))
        run = begun_run(config, folder / place)
        shutil.copy(GOLDEN / "progress.csv", run.progress)
        if evaluation:
            run.write_summary({"env_steps": 1_500_160, "wall_seconds": 48.2, "evaluation": evaluation})
    return folder


@pytest.fixture
def opened(open_page, page_server, results):
    page = open_page(page_server.address)
    tick(page, "mine", "penalty/c0.3-seed4", "penalty/c0-seed4")
    return page


def tick(opened: Any, *names: str) -> None:
    until(opened, "document.querySelectorAll('#runs input').length >= 3")
    for name in names:
        opened.check(f"[data-run='{name}']")
    until(opened, f"corridor.learning.charts[0].values(0).length === {len(names)}", 20)
    settle(opened)


def table(opened: Any, home: str) -> list[list[str]]:
    rows = "all => all.map(row => [...row.cells].map(cell => cell.innerText.trim()))"
    return opened.eval_on_selector_all(f"#{home} tr", rows)


def test_runs_in_studies_are_listed_under_their_study(opened):
    groups = opened.eval_on_selector_all(
        "#runs section",
        "all => all.map(box => [box.querySelector('h3')?.innerText ?? '',"
        " [...box.querySelectorAll('input')].map(input => input.dataset.run).sort()])",
    )
    assert groups == [["", ["mine"]], ["penalty", ["penalty/c0-seed4", "penalty/c0.3-seed4"]]]
    failed = opened.locator("#runs li", has_text="c0-seed4").inner_text()
    assert "in its evaluation no successes, wall contact 13%" in failed
    assert "success 94%" in failed  # of the last training episodes


def test_evaluations_stand_beside_the_curves(opened):
    head, *rows = table(opened, "evaluations")
    found = {row[0]: dict(zip(head[1:], row[1:], strict=True)) for row in rows}
    assert found["penalty/c0.3-seed4"] == {
        "success": "97%",
        "return": "0.61",
        "episode length, decisions": "228",
        "length of successes, decisions": "231",
        "opponent contact, episodes": "3%",
        "wall contact, episodes": "12.5%",
        "episodes": "200",
        "policy after, agent steps": "1,500,160",
    }
    assert found["penalty/c0-seed4"]["length of successes, decisions"] == "no successes"
    assert found["mine"]["success"] == "not evaluated yet"
    assert opened.evaluate("corridor.learning.charts[1].plot.scales.x.max") == 1_500_160  # where the diamonds are


@in_each_browser
def test_settings_that_differ_are_told_from_all_settings(opened):
    head, *rows = table(opened, "settings")
    assert set(head[1:]) == {"mine", "penalty/c0.3-seed4", "penalty/c0-seed4"}
    [[name, *values]] = rows
    assert name == "curiosity.c"
    assert dict(zip(head[1:], values, strict=True)) == {
        "mine": "0.3",
        "penalty/c0.3-seed4": "0.3",
        "penalty/c0-seed4": "0.0",
    }
    opened.focus("#only-differences")
    opened.keyboard.press("Space")
    every = {row[0]: row[1] for row in table(opened, "settings")[1:]}
    assert (every["ppo.gamma"], every["curiosity.intrinsic"], every["engine.width"]) == ("0.96", "icm", "84")
    opened.keyboard.press("Space")
    opened.uncheck("[data-run='penalty/c0-seed4']")
    assert opened.inner_text("#settings") == "The ticked runs have the same settings."
    opened.uncheck("[data-run='mine']")
    assert len(table(opened, "settings")) == 1 + len(every)  # of one run, all


def test_a_run_keeps_its_colour_whatever_else_is_shown(opened, open_page, page_server, results):
    def styles(page: Any) -> dict[str, list[str]]:
        return dict(
            page.eval_on_selector_all(
                "#runs li",
                "all => all.map(row => [row.querySelector('input').dataset.run, [...row.querySelectorAll('path')]"
                ".map(path => path.getAttribute('style') + path.getAttribute('stroke-dasharray'))[0]])",
            )
        )

    before = styles(opened)
    assert len(set(before.values())) == 3
    for number in range(3):
        recorded_run(results, f"c0-seed{number}")
        recorded_run(results / "another", f"mine{number}")
    shutil.rmtree(results / "penalty" / "c0.3-seed4")
    again = open_page(page_server.address)
    until(again, "document.querySelectorAll('#runs input').length === 8")
    after = styles(again)
    assert {name: after[name] for name in ("mine", "penalty/c0-seed4")} == {
        name: before[name] for name in ("mine", "penalty/c0-seed4")
    }
    assert len({after[f"c0-seed{number}"] for number in range(3)}) == 3  # seeds never look alike
    drawn = opened.evaluate("corridor.learning.charts[0].plot.series.slice(1).map(({label, dash}) => [label, dash])")
    assert {name: " ".join(map(str, dash)) for name, dash in drawn} == {
        name: re.sub(r".*\)", "", style) for name, style in before.items()
    }


@in_each_browser
def test_focus_and_rows_stay_while_runs_go_on(opened, results):
    opened.focus("[data-run='penalty/c0.3-seed4']")
    opened.evaluate("window.row = document.activeElement")
    opened.evaluate("corridor.learning.charts.forEach(chart => (chart.draw = () => (window.drawn = true)))")
    opened.wait_for_timeout(2500)
    assert opened.evaluate("window.drawn") is None  # nothing has changed
    progress = results / "mine" / "progress.csv"
    lines = progress.read_text().splitlines(keepends=True)
    progress.write_text("".join(lines[:-2]))
    steps = int(lines[-3].split(",")[0])
    until(opened, f"document.querySelector('#runs').innerText.includes('{steps:,} steps')")
    until(opened, "window.drawn > 0")
    assert opened.evaluate("document.activeElement === window.row && window.row.isConnected")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_axe_finds_nothing(open_page, page_server, results, scheme):
    opened = open_page(page_server.address, color_scheme=scheme)
    tick(opened, "mine", "penalty/c0.3-seed4", "penalty/c0-seed4")
    opened.focus("#curves [data-column=success_rate]")
    opened.keyboard.press("ArrowRight")
    assert violations(opened) == []


@in_each_browser
def test_no_width_scrolls_sideways(opened):
    for width in (320, 390, 640, 641, 768, 900, 901, 1024, 1280, 1600, 1920):
        opened.set_viewport_size({"width": width, "height": DESKTOP["height"]})
        settle(opened)
        assert opened.evaluate("document.documentElement.scrollWidth") <= width


def test_the_page_is_one_file_of_at_most_1_5_mb_that_asks_for_no_other(opened):
    assert PAGE.stat().st_size < 1.5e6
    asked = opened.evaluate("performance.getEntriesByType('resource').map(({name}) => new URL(name).pathname)")
    assert set(asked) == {"/api/runs"}
