"""``corridor replay STUDY``: the report of a study's folder as ``corridor study`` leaves it."""

import json
from pathlib import Path
from typing import Any

import pytest
from axe import violations
from conftest import in_each_browser
from page_in_browser import MINUS, PHONE, is_firefox, settle
from PIL import Image
from recorded_run import recorded_run

from trainer.errors import TrainerError
from trainer.main import main
from trainer.terminal import Terminal
from trainer.viewer.study_page import write_study_page

CLAIMS = [
    {"id": "C1", "statement": "Base PPO fails", "measure": "IQM < 0.05", "holds": True, "evidence": "0.00 [0, 0]"},
    {"id": "C2", "statement": "c = 0.3 works <b>", "measure": "IQM >= 0.9", "holds": False, "evidence": "0.85"},
]
EVALUATION = {
    "success_rate": 0.83,
    "mean_return": 0.29,
    "mean_episode_length": 226.0,
    "mean_success_length": 210.0,
    "opponent_contact_rate": 0.0,
    "wall_contact_rate": 0.5,
}
FAILED = {**EVALUATION, "success_rate": 0.0, "mean_success_length": None}
RESULT = {"runs": 2, "success_rate": {"value": 0.5, "low": 0.25, "high": 1}, "steps_to_90_success": None}
NEVER = ["no successes", "never reached"]
WIDTHS = (320, 390, 640, 641, 768, 900, 1024, 1280, 1920)


@pytest.fixture
def study(tmp_path: Path) -> Path:
    folder = tmp_path / "results" / "penalty"
    for place, run_id in ((folder, "c0-seed4"), (folder.parent / "other", "c0.3-seed4"), (folder, "c0.3-seed5")):
        run = recorded_run(place, run_id)
        run.write_summary({"evaluation": FAILED if run_id.startswith("c0-") else EVALUATION})
    (folder / "c0.3-seed5" / "trajectories.npz").unlink()
    arms = [{"name": "c0", "label": "base PPO", **RESULT}, {"name": "c0.3", "label": "c = 0.3", **RESULT}]
    arms[0] |= {"mean_success_length": None, "mean_return": {"value": -1.5, "low": -2, "high": -1}}
    arms[1] |= {"steps_to_90_success": {"value": 198000.0, "low": 167400, "high": 279000}}
    record = {"study": "penalty", "claims": CLAIMS, "arms": arms, "seeds": 2, "first_seed": 4, "steps": 1_500_000}
    (folder / "claims.json").write_text(json.dumps({**record, "command": "corridor study penalty --seeds 2"}))
    for name in ("figure6a", "figure6b", "another"):
        Image.new("RGB", (60, 40), "white").save(folder / f"{name}.png")
    return folder


@pytest.fixture
def report(study: Path) -> str:
    assert main(["replay", "penalty", "--results-dir", str(study.parent), "--episodes", "3"]) == 0
    return (study / "report.html").as_uri()


def table(opened: Any, caption: str) -> list[list[str]]:
    every = opened.eval_on_selector_all(
        "#study table",
        "all => all.map(table => [table.caption.textContent,"
        " [...table.rows].map(row => [...row.cells].map(cell => cell.textContent))])",
    )
    return dict(every)[caption]


def test_the_report_has_claims_results_and_captions(report, open_page):
    opened = open_page(report)
    assert "corridor study penalty --seeds 2" in opened.inner_text("#subtitle")
    assert table(opened, "Claims of the paper")[1:] == [
        ["C1", "Base PPO fails", "IQM < 0.05", "yes", "0.00 [0, 0]"],
        ["C2", "c = 0.3 works <b>", "IQM >= 0.9", "no", "0.85"],
    ]
    head, base, curious = table(opened, "Results by arm")
    assert head == [
        "arm",
        "runs",
        "success",
        "return",
        "length of successes, decisions",
        "thousand steps to 90% success",
    ]
    assert base == ["base PPO", "2", "50.0% [25.0%, 100.0%]", f"{MINUS}1.50 [{MINUS}2.00, {MINUS}1.00]", *NEVER]
    assert curious[-1] == "198 [167, 279]"
    assert opened.evaluate("[...document.images].map(image => image.naturalWidth)") == [60] * 3
    captions = opened.locator("#study figcaption").all_inner_texts()
    assert [caption[:25] for caption in captions[1:]] == ["The paper's Fig. 6a has t", "The paper's Fig. 6b has t"]
    assert all("Thick: interquartile mean" in caption for caption in captions)
    assert opened.inner_text("#notes") == "There is no evaluation on a corridor of c0-seed5, c0.3-seed5, so no replay."
    assert table(opened, "Runs of base PPO")[1:] == [
        ["c0-seed4", "0%", "0.29", "226", "no successes", "0%", "50%"],
        ["c0-seed5, no replay", "not evaluated", *[""] * 5],
    ]


@in_each_browser
@pytest.mark.parametrize("how", ["pointer", "keys"])
def test_a_studys_runs_are_one_click_from_their_replay_and_back(report, open_page, how):
    opened = open_page(report)

    def follow(link: str) -> None:
        if how == "pointer":
            opened.click(link)
        else:
            opened.focus(link)
            opened.keyboard.press("Enter")

    for run_id in ("c0-seed4", "c0.3-seed4"):  # the second's folder is another study's
        follow(f"#study a:text-is('{run_id}')")
        opened.wait_for_selector("#episode-list li")
        assert opened.inner_text("#subtitle").startswith(run_id)
        assert opened.locator("#episode-list li").count() == 3
        follow("a.back")
        opened.wait_for_selector("#study table")
        assert opened.url == report


def test_a_replay_has_no_way_back_to_anything_but_a_report(report, study, open_page):
    replay = (study / "c0-seed4" / "replay.html").as_uri()
    opened = open_page(replay)
    for place in ("", "?from=https://evil.example/report.html", "?from=javascript:alert(1)//report.html", "?from=x"):
        opened.goto(replay + place)
        opened.wait_for_selector("#episode-list li")
        assert opened.locator("a.back").count() == 0


@in_each_browser
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_report_is_accessible_and_reads_at_any_width(report, open_page, scheme):
    opened = open_page(report, color_scheme=scheme)
    if is_firefox(opened) and scheme == "dark":
        pytest.skip("Playwright has no dark scheme in Firefox")
    for width in WIDTHS:
        opened.set_viewport_size({"width": width, "height": 844})
        settle(opened)
        assert opened.evaluate("document.documentElement.scrollWidth") <= width
    assert violations(opened) == []
    opened.set_viewport_size(PHONE)
    assert violations(opened) == []
    cell = opened.locator("#study table td").first  # beside its column's head, not below it
    assert cell.get_attribute("data-head") == "the paper says"
    content = cell.evaluate("cell => getComputedStyle(cell, '::before').content")
    assert content == ("attr(data-head)" if is_firefox(opened) else '"the paper says"')


def test_a_study_of_another_environment_says_nothing_of_the_papers(study, open_page):
    record = json.loads((study / "claims.json").read_text())
    arms = [{"name": "c0", "label": "base PPO", "runs": 20, "mean_return": {"value": 90, "low": 80, "high": 95}}]
    record |= {"claims": [], "arms": arms, "seeds": 20, "first_seed": 30}
    (study / "claims.json").write_text(json.dumps(record))
    Image.new("RGB", (60, 40), "white").save(study / "figure5a.png")
    opened = open_page(write_study_page(study, 3, Terminal()).as_uri())
    assert opened.locator("figcaption", has_text="Blue: c = 0.3; red: c = 0.1").count() == 1
    assert "paper" not in opened.inner_text("#study figure:has-text('Blue: c = 0.3; red: c = 0.1')")
    assert table(opened, "Results by arm") == [["arm", "runs", "return"], ["base PPO", "20", "90.00 [80.00, 95.00]"]]
    first = ", ".join(f"c0-seed{seed}" for seed in range(30, 38))
    assert opened.inner_text("#notes") == f"There is no evaluation on a corridor of {first} and 12 more, so no replay."


def test_a_broken_study_is_one_sentence(study):
    (study / "claims.json").write_text('{"claims": []}')
    with pytest.raises(TrainerError, match="claims.json is broken"):
        write_study_page(study, 3, Terminal())
