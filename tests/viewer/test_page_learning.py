"""The page that follows runs as they learn: ``corridor watch`` as a process, looked at in headless Chromium."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest
from conftest import BIN
from page_in_browser import compare, until
from page_requests import address_of
from recorded_run import recorded_run


def start_watching(results: Path, port: int) -> tuple[subprocess.Popen[str], str]:
    command = [BIN / "corridor", "watch", "--results-dir", results, "--port", str(port)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env={**os.environ, "COLUMNS": "500"})
    return process, address_of(process)


def stop(process: subprocess.Popen[str]) -> None:
    process.terminate()
    assert process.wait(30) == 130
    assert process.stdout
    process.stdout.close()


@pytest.mark.slow
def test_learning_is_followed_and_runs_lie_over_each_other(open_page, tmp_path, free_port):
    results = tmp_path / "results"
    process, address = start_watching(results, free_port)
    opened = open_page(address, in_3d=True)
    until(opened, "document.querySelector('#notes').innerText.startsWith('There is no run yet')")
    for _ in range(2):
        assert opened.evaluate("location.href") == address.partition("?")[0]  # without the token
        opened.reload()
        until(opened, "document.querySelector('#notes')?.innerText.startsWith('There is no run yet')")
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
