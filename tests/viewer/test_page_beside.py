"""Runs' episodes in the page of ``corridor watch``: two beside each other, and what stays when a run goes away."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from conftest import in_each_browser
from eventful import eventful
from page_in_browser import PHONE, at, choose, readout, settle, until
from recorded_run import begun_run, recorded_run

from trainer.runs.folder import RunFolder
from trainer.runs.trajectories import save_trajectories
from trainer.viewer.page_server import PageServer

Two = tuple[RunFolder, RunFolder]


@pytest.fixture
def two(tmp_path: Path) -> Two:
    """Runs that were evaluated on the same episodes, one of which takes its time."""
    folders = []
    for run_id, haste in (("slow", 0.6), ("quick", 1.0)):
        config, trajectories = eventful(run_id, haste)
        folders.append(begun_run(config, tmp_path / "results"))
        save_trajectories(folders[-1].trajectories, trajectories)
    return folders[0], folders[1]


def open_episode(open_page: Callable[..., Any], server: PageServer, place: str, **options: Any) -> Any:
    opened = open_page(f"{server.address}#{place}", **options)
    until(opened, "corridor.list.onStage !== null")
    settle(opened)
    return opened


@in_each_browser
@pytest.mark.parametrize("options", [{}, {"viewport": PHONE, "has_touch": True}], ids=["desk", "phone"])
def test_two_runs_stand_beside_each_other_at_one_time(open_page, page_server, two, options):
    lengths = {
        run_id: len(eventful(run_id, haste)[1].episodes[0].rewards) for run_id, haste in (("slow", 0.6), ("quick", 1))
    }
    opened = open_episode(open_page, page_server, "run=slow&episode=0&t=2", in_3d=True, **options)
    assert opened.is_visible("#view3d")
    opened.focus("#beside-run")
    opened.keyboard.press("ArrowDown")
    until(opened, "corridor.stage.beside?.name === 'quick'")
    settle(opened)
    assert opened.evaluate("document.activeElement.id") == "beside-run"
    assert opened.evaluate("corridor.stage.time") == 20
    assert not opened.is_visible("#view3d")
    for id, run_id in (("top", "slow"), ("beside", "quick")):
        assert opened.inner_text(f"#caption-{id}").startswith(f"{run_id}: failed after {lengths[run_id] / 10:.1f} s")
        assert opened.locator(f"#canvas-{id}").bounding_box()["width"] > 200
    assert opened.evaluate("corridor.stage.end") == max(lengths.values())
    for row in (30, 60, lengths["slow"]):
        at(opened, row)
        for index, (run_id, haste) in enumerate((("slow", 0.6), ("quick", 1.0))):
            episode = eventful(run_id, haste)[1].episodes[0]
            said = opened.locator(".readout").nth(index).inner_text().split("\n")
            d = episode.observations[min(row, len(episode.rewards)), 10]
            assert f"{d:.3f}" in said
            assert run_id in said
    assert opened.locator("#marks .lane").count() == 2
    until(opened, f"location.hash === '#run=slow&episode=0&t={lengths['slow'] / 10:.1f}&beside=quick'")
    opened.keyboard.press("ArrowUp")  # none
    until(opened, "corridor.stage.beside === null && !document.body.classList.contains('comparing')")
    assert opened.is_visible("#view3d")


def test_an_address_comes_back_with_the_run_beside_and_says_what_is_not_there(open_page, page_server, two, tmp_path):
    opened = open_episode(open_page, page_server, "run=slow&episode=2&t=1.5&beside=quick")
    assert opened.evaluate("[corridor.stage.time, corridor.stage.beside?.name, corridor.list.onStage]") == [
        15,
        "quick",
        2,
    ]
    assert opened.input_value("#episode-run") == "slow"
    opened.reload()
    until(opened, "window.corridor?.list.onStage === 2")
    assert opened.evaluate("[corridor.stage.time, corridor.stage.beside?.name]") == [15, "quick"]
    recorded_run(tmp_path / "results", "other")  # another seed's episodes
    until(opened, "document.querySelector('#beside-run').options.length === 3")
    opened.select_option("#beside-run", "other")
    until(opened, "document.querySelector('#notes').innerText.includes('Episode 2 of other begins differently')")
    recorded_run(tmp_path / "results", "young", evaluated=False)
    until(opened, "document.querySelector('#beside-run').options.length === 4")
    opened.select_option("#beside-run", "young")
    until(opened, "document.querySelector('#notes').innerText.includes('young has no evaluation of its own yet')")
    assert opened.evaluate("corridor.stage.beside") is None


def test_an_address_that_leads_nowhere_says_so(open_page, page_server, two):
    for place, sentence in (
        ("run=nobody&episode=2", "There is no run nobody in "),
        ("run=slow&episode=77", "There is no episode 77 of slow, whose evaluation has 3, from 0."),
    ):
        opened = open_episode(open_page, page_server, place)
        until(opened, f"document.querySelector('#notes').innerText.includes('{sentence}')")


def test_a_run_that_vanishes_keeps_what_was_seen(open_page, page_server, two):
    opened = open_episode(open_page, page_server, "run=slow&episode=0&t=3")
    opened.select_option("#episode-run", "quick")
    until(opened, "corridor.stage.name === 'quick'")
    opened.keyboard.press("End")
    for folder in two:
        shutil.rmtree(folder.path)
    until(opened, "document.querySelector('#notes').innerText.includes('Its folder is gone')")
    choose(opened, 1)
    at(opened, 20)
    assert readout(opened)["d_opp"] == f"{eventful()[1].episodes[1].observations[20, 10]:.3f}"
    opened.select_option("#episode-run", "slow")  # seen before
    until(opened, "corridor.stage.name === 'slow'")
    assert opened.locator("#episode-list [role=option]").count() == 3
    opened.click("[data-tab=drive]")
    until(opened, "document.querySelector('#notes').innerText.includes('is gone')")


@in_each_browser
def test_an_address_without_its_token_is_a_page_that_says_so(open_page, page_server):
    whole, bare = page_server.address, page_server.address.partition("?")[0]
    for address, sentence in (
        (bare, "The address has no token; open the whole address that 'corridor watch' printed, ?token= included."),
        (whole[:-1], "This is another 'corridor watch' than the page's; open the address that it printed."),
    ):
        opened = open_page(address)
        assert opened.inner_text("main").split("\n\n") == ["This page needs its token", sentence]
    opened = open_page(f"{whole}#run=x&episode=1")
    until(opened, f"location.href === '{bare}#run=x&episode=1'")
    opened.reload()  # the tab keeps the token, and the place
    until(opened, f"window.corridor && location.href === '{bare}#run=x&episode=1'")
