"""``--open`` hands the page to the user's browser: here, to a program that writes down what it is given."""

import os
from pathlib import Path

import pytest
from conftest import corridor_here
from recorded_run import recorded_run

from trainer.viewer.page_server import PageServer


@pytest.fixture
def opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    program, address = tmp_path / "browser", tmp_path / "address"
    program.write_text(f"#!/bin/sh\necho $1 > {address}\n")
    program.chmod(0o700)
    monkeypatch.setattr("webbrowser._tryorder", None)  # it looks for browsers once in a process
    monkeypatch.setenv("BROWSER", f"{program} %s")
    return address


@pytest.mark.slow
def test_the_page_of_a_replay_is_opened(tmp_path, opened):
    folder = recorded_run(tmp_path)
    done = corridor_here("replay", "fast", "--results-dir", tmp_path, "--open", "--episodes", 1)
    assert done.returncode == 0, done.stderr
    assert opened.read_text().strip() == (folder.path / "replay.html").as_uri()


def test_the_page_of_a_watch_is_opened_once_it_can_be(tmp_path, opened, monkeypatch):
    served = []
    monkeypatch.setattr(PageServer, "serve_forever", lambda server: served.append(server.address))
    done = corridor_here("watch", "--results-dir", tmp_path, "--port", 0, "--open")
    assert done.returncode == 0, done.stderr
    assert opened.read_text().strip() == served[0]
    assert served[0] in done.stdout


def test_without_a_browser_the_user_is_told(tmp_path, opened, monkeypatch):
    monkeypatch.setenv("BROWSER", f"{tmp_path}/none %s")
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.delitem(os.environ, "DISPLAY", raising=False)
    monkeypatch.setattr(PageServer, "serve_forever", lambda server: None)
    done = corridor_here("watch", "--results-dir", tmp_path, "--port", 0, "--open")
    assert done.returncode == 0
    assert done.stderr == "No browser could be started; open the page by hand.\n"
    assert not opened.exists()


def test_nothing_is_opened_unasked(tmp_path, opened, monkeypatch):
    monkeypatch.setattr(PageServer, "serve_forever", lambda server: None)
    assert corridor_here("watch", "--results-dir", tmp_path, "--port", 0).returncode == 0
    assert not opened.exists()
