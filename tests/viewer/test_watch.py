"""``corridor watch``: what its server answers and refuses, and what it makes of runs that come, grow, break and go."""

import html
import http.client
import os
import shutil
import signal
import socket
import subprocess
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import pytest
from conftest import BIN, corridor_here
from page_requests import address_of, ask
from recorded_run import GOLDEN, recorded_run

from trainer.runs.trajectories import load_trajectories
from trainer.viewer.document import PAGE
from trainer.viewer.live import LiveEvaluations
from trainer.viewer.page_server import CONNECTIONS, NO_TOKEN, OTHER_TOKEN, PageServer
from trainer.viewer.watched_runs import LISTED, QUIET_SECONDS, WatchedRuns

NOTHING = {"runs": [], "curves": {}, "settings": {}, "unlisted": 0}


def runs(page_server: PageServer) -> dict[str, dict]:
    return {run["name"]: run for run in ask(page_server, "/api/runs")[1]["runs"]}


def wait_for_scene(page_server: PageServer, name: str) -> dict:
    for _ in range(600):
        status, answer = ask(page_server, f"/api/scene?run={name}")
        assert status == 200, answer
        if answer["scene"]:
            return answer["scene"]
        assert answer["note"] == "Its newest checkpoint is being played."
        time.sleep(0.1)
    raise AssertionError("no scene came")


def test_the_page_comes_with_the_token_only(page_server):
    assert ask(page_server, f"/?token={page_server.token}")[1]["page"].startswith("<!doctype html>")
    assert ask(page_server, page_server.address.partition(str(page_server.server_port))[2])[0] == 200
    for path, sentence in (
        ("/", NO_TOKEN),
        ("/?token=", NO_TOKEN),
        (f"/?token={page_server.token[:-1]}", OTHER_TOKEN),
        ("/?token=%C3%A9", OTHER_TOKEN),
    ):
        status, answer = ask(page_server, path)
        assert status == 403
        assert html.escape(sentence) in answer["page"]


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "127.0.0.1"},
        {"Host": "127.0.0.1:1"},
        {"X_Corridor_Token": "another"},
        {"X_Corridor_Token": None},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
    ],
)
def test_only_its_own_page_on_loopback_is_answered(page_server, headers):
    for path, body in (("/api/runs", None), ("/api/scene?run=x", None), ("/api/drive/new", {})):
        status, answer = ask(page_server, path, body, **headers)
        assert status == 403
        assert list(answer) == ["error"]
    assert page_server.server_address[0] == "127.0.0.1"


def test_slow_connections_are_bounded_and_do_not_keep_the_page_waiting(page_server):
    before = threading.active_count()
    own = http.client.HTTPConnection("127.0.0.1", page_server.server_port, timeout=30)
    token = {"X-Corridor-Token": page_server.token}
    own.request("GET", "/api/runs", headers=token)
    assert own.getresponse().read()
    begun = (b"", b"GET /", b"GET / HTTP/1.1\r\nHost: x\r\nX: ", b"POST / HTTP/1.1\r\nContent-Length: 9\r\n\r\n{")
    with ExitStack() as stack:
        for number in range(800):
            slow = stack.enter_context(socket.create_connection(("127.0.0.1", page_server.server_port), timeout=30))
            slow.sendall(begun[number % len(begun)])
        assert ask(page_server, f"/?token={page_server.token}")[0] == 200
        assert threading.active_count() <= before + CONNECTIONS
        own.request("GET", "/api/runs", headers=token)  # on the connection that it has had before
        assert own.getresponse().status == 200
    own.close()


def test_there_are_no_files(page_server, tmp_path):
    run = recorded_run(tmp_path / "results")
    (tmp_path / "secret").write_text("secret")
    for path in (
        "/configuration.yaml",
        "/../secret",
        "/fast/configuration.yaml",
        "/api/../../secret",
        str(run.summary),
    ):
        assert ask(page_server, path) == (404, {"error": "There is nothing here."})
    for name in ("..", "../results/fast", "fast/../fast", str(run.path), "", "%2e%2e"):
        status, answer = ask(page_server, f"/api/scene?run={name}")
        assert (status, "is gone" in answer["error"]) == (400, True)


def test_a_run_is_shown_from_its_first_file_to_its_deletion(page_server, tmp_path):
    assert ask(page_server, "/api/runs?run=fast")[1] == NOTHING
    run = recorded_run(tmp_path / "results", evaluated=False)
    run.progress.unlink()
    assert runs(page_server)["fast"]["status"] == "starting"
    assert runs(page_server)["fast"]["problem"] == "No progress yet."

    lines = (GOLDEN / "progress.csv").read_text().splitlines(keepends=True)
    run.progress.write_text("".join(lines[:3]) + lines[3][:20])  # a row that is being written
    answer = ask(page_server, "/api/runs?run=fast")[1]
    assert answer["runs"][0]["status"] == "training"
    assert len(answer["curves"]["fast"]["env_steps"]) == 2
    run.progress.write_text("".join(lines))
    answer = ask(page_server, "/api/runs?run=fast&run=nobody")[1]
    curves = answer["curves"]["fast"]
    assert len(curves["env_steps"]) == len(lines) - 1
    assert curves["mean_return"][-1] == float(lines[-1].split(",")[2])
    assert answer["runs"][0]["env_steps"] == curves["env_steps"][-1]
    assert answer["runs"][0]["success_rate"] > 0.9

    os.utime(run.progress, (time.time() - QUIET_SECONDS - 60,) * 2)
    assert runs(page_server)["fast"]["status"] == "no news for 3 min"
    run.write_summary({"evaluation": None})
    assert runs(page_server)["fast"]["status"] == "stopped"
    run.write_summary({"evaluation": {"episodes": 12}})
    assert runs(page_server)["fast"]["status"] == "finished"

    shutil.copy(GOLDEN / "trajectories.npz", run.trajectories)
    scene = ask(page_server, "/api/scene?run=fast")[1]["scene"]
    assert len(scene["episodes"]) == 12
    stamp = runs(page_server)["fast"]["scene"]
    os.utime(run.trajectories)
    assert runs(page_server)["fast"]["scene"] != stamp  # evaluated again: the page asks for the new one

    shutil.rmtree(run.path)
    assert ask(page_server, "/api/runs?run=fast")[1] == NOTHING
    assert ask(page_server, "/api/scene?run=fast")[0] == 400
    recorded_run(tmp_path / "results")  # and again, as --force does it
    assert len(ask(page_server, "/api/scene?run=fast")[1]["scene"]["episodes"]) == 12


def test_runs_in_studies_are_found_and_drafts_are_not(page_server, tmp_path):
    results = tmp_path / "results"
    study = recorded_run(results / "penalty", "c0-seed4").path.parent
    recorded_run(results, "mine")
    recorded_run(results / "mine", "inside")  # a run's own folders are not looked into
    shutil.copytree(study / "c0-seed4", study / "c0-seed4~draft")
    shutil.copytree(study, results / "penalty~draft")
    answer = ask(page_server, "/api/runs?run=penalty/c0-seed4")[1]
    assert sorted(run["name"] for run in answer["runs"]) == ["mine", "penalty/c0-seed4"]
    assert list(answer["curves"]) == ["penalty/c0-seed4"]
    assert len(ask(page_server, "/api/scene?run=penalty/c0-seed4")[1]["scene"]["episodes"]) == 12


def test_settings_and_evaluation_of_a_run(page_server, tmp_path):
    run = recorded_run(tmp_path / "results")
    evaluation = {"episodes": 12, "success_rate": 0, "wall_contact_rate": 0.25, "mean_return": "broken"}
    run.write_summary({"env_steps": 1474560, "evaluation": evaluation})
    answer = ask(page_server, "/api/runs?run=fast")[1]
    settings = answer["settings"]["fast"]
    assert (settings["curiosity.c"], settings["ppo.anneal"], settings["env_args"]) == ("0.3", "yes", "none")
    assert "run_id" not in settings
    found = answer["runs"][0]["evaluation"]
    assert (found["success_rate"], found["wall_contact_rate"], found["env_steps"]) == (0, 0.25, 1474560)
    assert found["mean_return"] is found["mean_success_length"] is None
    news = answer["runs"][0]["news"]
    assert runs(page_server)["fast"]["news"] == news  # the page need not ask for curves again
    run.progress.write_text(run.progress.read_text()[:-1])
    assert runs(page_server)["fast"]["news"] != news


def test_a_look_at_many_runs_that_do_not_change_reads_no_file_and_is_under_1_percent_of_a_core(tmp_path, monkeypatch):
    first = recorded_run(tmp_path / "study", "run0")
    for number in range(1, LISTED + 5):
        shutil.copytree(first.path, first.path.with_name(f"run{number}"))
    watched = WatchedRuns(tmp_path, LiveEvaluations())
    before = watched.overview(["run0"])
    assert (len(before["runs"]), before["unlisted"]) == (LISTED, 5)
    monkeypatch.setattr(Path, "open", None)
    costs = []
    for _ in range(20):
        began = time.thread_time()
        assert watched.overview(["run0"]) == before
        costs.append(time.thread_time() - began)
    assert min(costs) < 0.01 * 2.0  # of the two seconds until the next look


def test_broken_files_are_said_to_be_broken_and_the_rest_is_shown(page_server, tmp_path):
    recorded_run(tmp_path / "results", "good")
    broken = recorded_run(tmp_path / "results", "broken")
    broken.configuration.write_text("{{{")
    broken.progress.write_bytes(b"\xff\x00env_steps\n,,,\n1,2\n")
    broken.summary.write_text("[")
    answer = runs(page_server)
    assert answer["good"]["problem"] is None
    assert "not a run's configuration" in answer["broken"]["problem"]
    assert "not a run's configuration" in ask(page_server, "/api/scene?run=broken")[1]["error"]
    torn = recorded_run(tmp_path / "results", "torn")
    torn.trajectories.write_bytes(b"PK")
    status, error = ask(page_server, "/api/scene?run=torn")
    assert (status, "is broken" in error["error"]) == (400, True)


def test_a_foreign_players_run_says_when_there_will_be_episodes(page_server, tmp_path):
    recorded_run(tmp_path / "results", "unity", env="editor", evaluated=False)
    assert "not the built-in one" in runs(page_server)["unity"]["problem"]
    assert ask(page_server, "/api/scene?run=unity")[1]["scene"] is None


@pytest.mark.slow
def test_the_newest_checkpoint_of_a_training_run_is_played(page_server, tmp_path):
    results = tmp_path / "results"
    options = ["--run-id", "r", "--results-dir", results, "--base-port", 5755, "--num-areas", 16, "--steps", 256]
    assert corridor_here("train", *options, "--eval-episodes", 16).returncode == 0
    before = {path: path.stat().st_mtime_ns for path in results.rglob("*") if path.is_file()}
    recorded = load_trajectories(results / "r" / "trajectories.npz")
    [checkpoint] = (results / "r" / "checkpoints").glob("step-*.safetensors")
    os.utime(checkpoint)  # newer than the evaluation, as while the run goes on
    assert runs(page_server)["r"]["scene"] == checkpoint.stem
    scene = wait_for_scene(page_server, "r")
    assert scene["env_steps"] == recorded.env_steps
    assert scene["notes"] == []  # equal to the in-process world bit for bit
    assert [record["goal"] for record in scene["episodes"]] == [
        (episode.observations[0, 4:6].astype(float) * 10).tolist() for episode in recorded.episodes[:4]
    ]
    # Only read: no file of the run has changed.
    after = {path: path.stat().st_mtime_ns for path in results.rglob("*") if path.is_file()}
    assert {path for path in after if after[path] != before.get(path)} == {checkpoint}

    checkpoint.write_bytes(b"torn")
    checkpoint.rename(checkpoint.with_name("step-0000009999.safetensors"))
    for _ in range(100):
        status, answer = ask(page_server, "/api/scene?run=r")
        if status != 200:
            break
        time.sleep(0.1)
    assert "is damaged" in answer["error"]


def test_a_wrong_results_folder_is_named(tmp_path):
    run = recorded_run(tmp_path / "results")
    for folder, sentence in ((run.path, f"give {run.path.parent}."), (run.summary, "which is a file")):
        run.summary.touch()
        done = corridor_here("watch", "--results-dir", folder, "--port", 0)
        assert done.returncode == 1
        assert f"--results-dir is {folder}" in done.stderr
        assert sentence in done.stderr
        assert len(done.stderr.strip().splitlines()) == 1
    process = subprocess.Popen(
        [BIN / "corridor", "watch", "--results-dir", "reslts", "--port", "0"], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout
    address_of(process)
    assert process.stdout.readline() == "There is no folder reslts yet; is it the right --results-dir?\n"
    process.terminate()
    assert process.wait(30) == 130
    process.stdout.close()


def test_a_port_in_use_and_a_clean_end(tmp_path):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        options = ["watch", "--results-dir", tmp_path, "--port"]
        done = corridor_here(*options, port)
        assert done.returncode == 1
        assert f"Port {port} can't be opened" in done.stderr
    done = corridor_here(*options, 70000)
    assert "ports go from 1 to 65535" in done.stderr
    for number in (signal.SIGINT, signal.SIGTERM):
        process = subprocess.Popen([BIN / "corridor", *options, "0"], stdout=subprocess.PIPE, text=True)
        assert process.stdout
        address_of(process)
        process.send_signal(number)
        assert process.wait(30) == 130
        process.stdout.close()


def test_the_page_is_in_the_package():
    assert PAGE.stat().st_size > 100_000
