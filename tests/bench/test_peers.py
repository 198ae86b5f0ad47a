"""``corridor bench --peers`` measures what it says: real steps, in turns, of programs that have only what they need."""

import ast
import io
import itertools
import json
import os
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from corridor_server.corridor.gym_env import CorridorEnv
from trainer.bench import measure, peer_environments, peers
from trainer.bench.beside_peers import OURS, beside_peers, mlagents_config, peer_settings
from trainer.bench.learning_process import LearningProcess, MLAgentsProcess
from trainer.bench.measure import run_peers
from trainer.bench.peer_environments import Peer, importable, install, installed
from trainer.bench.peers.corridor_arrays import CorridorArrays
from trainer.bench.peers.corridor_slots import CorridorSlots
from trainer.bench.peers.install_size import needed
from trainer.bench.peers.peer_settings import PeerSettings
from trainer.bench.peers.turns import Turns
from trainer.bench.workload import Workload
from trainer.errors import TrainerError
from trainer.terminal import Terminal

PROGRAMS = sorted(Path(peers.__path__[0]).glob("*.py"))
SMALL = Workload(rounds=1, peer_areas=8, peer_seconds=0.05)
SB3 = Peer("SB3", "sb3_program", "stable-baselines3")
TORCH = Peer("torch", "torch_program", "torch")
BROKEN = Peer("nobody's", "nobodys_program", "nobodys", pins=("/nowhere/nobodys-1.0-py3-none-any.whl",))
# Counts to 100 a second, in steps of mlagents-learn's summaries.
COUNTING = """
import itertools, time
print("a banner")
for step in itertools.count(1):
    time.sleep(0.01)
    print(f"[INFO] Corridor. Step: {step}. Time Elapsed: {step / 100} s. No episode was completed.", flush=True)
"""


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda path: path.stem)
def test_programs_import_nothing_of_ours_but_the_corridor(program):
    names = {
        name
        for node in ast.walk(ast.parse(program.read_text()))
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([node.module] if isinstance(node, ast.ImportFrom) else [each.name for each in node.names])
    }
    ours = {name for name in names if name.partition(".")[0] in ("trainer", "corridor_server")}
    allowed = ("trainer.bench.peers.", "corridor_server.corridor.", "corridor_server.protocol.agents")
    assert program.stem == "our_program" or all(name.startswith(allowed) for name in ours)


def test_the_one_for_unitys_python_has_no_newer_syntax():
    ast.parse((Path(peers.__path__[0]) / "install_size.py").read_text(), feature_version=(3, 10))


def test_arrays_step_as_every_areas_own_environment_does():
    """To the bit, over ends: observations, rewards, who ended, and what it saw last."""
    areas, parameters = 3, {"failure_return": -0.3, "max_episode_steps": 60}
    arrays = CorridorArrays(areas, 5, parameters, normalised=False)
    alone = [CorridorEnv(area=area, **parameters) for area in range(areas)]
    observations = arrays.reset()
    np.testing.assert_array_equal(observations, [each.reset(seed=5)[0] for each in alone])
    generator, ends = np.random.default_rng(0), []
    for _ in range(200):
        actions = generator.uniform(-1, 1, (areas, 2)).astype(np.float32)
        actions[1] = 0.0, 1.0  # into a wall
        stepped = arrays.step(actions)
        for area, environment in enumerate(alone):
            seen, reward, terminated, truncated, _ = environment.step(actions[area])
            assert (stepped.terminated[area], stepped.truncated[area]) == (terminated, truncated)
            assert stepped.rewards[area] == np.float32(reward)
            if terminated or truncated:
                ends.append("cut" if truncated else "ended")
                np.testing.assert_array_equal(stepped.last_observations[list(stepped.ended).index(area)], seen)
                seen = environment.reset()[0]
            np.testing.assert_array_equal(stepped.observations[area], seen)
    assert set(ends) == {"cut", "ended"}
    assert arrays.steps == 200 * areas


def test_normalised_arrays_have_the_mean_and_deviation_of_all_that_was_seen():
    plain, normalised = (CorridorArrays(16, 1, {}, normalised=each) for each in (False, True))
    seen = [plain.reset()]
    normalised.reset()
    for _ in range(30):
        seen.append(plain.step(np.ones((16, 2), np.float32)).observations)
        last = normalised.step(np.ones((16, 2), np.float32)).observations
    everything = np.concatenate(seen)
    expected = (seen[-1] - everything.mean(axis=0)) / np.sqrt(everything.var(axis=0) + 1e-8)
    moves = everything.var(axis=0) > 1e-3
    assert moves.sum() > 5
    np.testing.assert_allclose(last[:, moves], np.clip(expected, -10, 10)[:, moves], atol=2e-3)


def test_slots_show_ends_as_sb3_has_them():
    slots = CorridorSlots(CorridorArrays(2, 0, {"max_episode_steps": 2}, normalised=False))
    slots.reset()
    still = np.zeros((2, 2), np.float32)
    assert not slots.step(still)[2].any()
    observations, _, dones, infos = slots.step(still)
    assert dones.all()
    assert all(info["TimeLimit.truncated"] for info in infos)
    assert not np.array_equal(infos[0]["terminal_observation"], observations[0])


def test_a_program_learns_only_in_its_turns(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", io.StringIO("0.05\n0\n"))
    turns, steps = Turns(warm_up=3), 0
    for updates in itertools.count():
        if not turns.goes_on(steps, reward=steps / 4, loss=1.0):
            break
        steps += 10
        time.sleep(0.01)
        assert updates < 20
    ready, first, second = capsys.readouterr().out.splitlines()
    assert ready == "ready"
    found = json.loads(first)
    assert found["seconds"] >= 0.05
    assert found["reward"] == 0.25
    assert json.loads(second)["steps"] == 10
    assert 30 + found["steps"] + 10 == steps


def test_a_loss_that_is_no_number_is_said(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", io.StringIO("0\n"))
    turns = Turns(warm_up=0)
    while turns.goes_on(0, 0.0, float("nan")):
        pass
    assert json.loads(capsys.readouterr().out.splitlines()[1])["loss"] is None


def test_packages_are_sized_with_what_they_need_and_the_extras_asked_for():
    client, trainer = needed(["curious-corridor[client]"]), needed(["curious-corridor[trainer]"])
    assert {"mlagents-envs", "gymnasium", "grpcio"} <= client.keys()
    assert "torch" not in client
    assert {"torch", "numba", "mlagents-envs"} <= trainer.keys()
    assert not {"ray", "pytest"} & trainer.keys()
    assert needed(["nobodys-package>=3"]) == {}


def test_mlagents_learn_is_told_the_same():
    settings = PeerSettings(**peer_settings(128))
    (behavior,) = mlagents_config(settings)["behaviors"].values()
    assert behavior["hyperparameters"]["buffer_size"] == 128 * settings.n_steps == settings.rollout
    assert behavior["hyperparameters"]["batch_size"] * settings.minibatches == settings.rollout


def test_mlagents_learn_stands_still_between_turns(tmp_path):
    command = [sys.executable, "-c", COUNTING]
    with MLAgentsProcess("counting", command, [0], {}, tmp_path) as learner:
        first = learner.turn(0.2)
        time.sleep(0.5)
        begun = time.perf_counter()
        second = learner.turn(0.2)
        assert time.perf_counter() - begun < 5
    assert 1 < first.rate < 110
    assert 1 < second.rate < 110  # with the half second in it, it would have the steps of that too


def test_a_program_that_ends_at_once_is_quoted(tmp_path):
    with pytest.raises(TrainerError, match="mine ended before it measured anything: ValueError: 3 is too many"):
        LearningProcess("mine", [sys.executable, "-c", "raise ValueError('3 is too many')"], [0], {}, tmp_path)


def test_a_broken_accelerator_is_one_line_before_the_rates(monkeypatch):
    monkeypatch.setattr(measure, "PROBLEM", "Numba can't be used (gone), so training is slower.")
    monkeypatch.setattr(measure, "beside_peers", lambda *_: iter(()))
    console = Terminal(record=True, width=160)
    run_peers(None, None, None, 0, console)
    assert console.export_text().startswith("Numba can't be used (gone), so training is slower.\n")


def test_what_was_measured_is_kept_when_it_is_stopped(monkeypatch, tmp_path):
    def stopped(*_):
        yield {"name": "one", "problem": "It is only a test."}
        raise KeyboardInterrupt

    monkeypatch.setattr(measure, "beside_peers", stopped)
    with pytest.raises(KeyboardInterrupt):
        run_peers(tmp_path / "peers.json", None, None, 0, Terminal())
    assert [row["name"] for row in json.loads((tmp_path / "peers.json").read_text())["peers"]] == ["one"]


@pytest.mark.slow
def test_what_cant_be_installed_says_pips_last_line_and_leaves_nothing_whole(monkeypatch, tmp_path):
    monkeypatch.setattr(peer_environments, "CACHE", tmp_path)
    with pytest.raises(TrainerError, match=r"^nobody's can't be installed: .*nobodys-1.0"):
        install(BROKEN)
    assert not (tmp_path / BROKEN.module / peer_environments.WHOLE).exists()


@pytest.mark.slow
def test_every_row_is_there_as_soon_as_it_is_measured(monkeypatch, tmp_path, free_port):
    def cant(peer):
        if peer is BROKEN:
            raise TrainerError("nobody's can't be installed: ERROR: none")
        return sys.executable

    one_core = {min(os.sched_getaffinity(0))}
    system = SimpleNamespace(environ=os.environ, sched_getaffinity=lambda _: one_core, sched_setaffinity=None)
    monkeypatch.setattr("trainer.bench.beside_peers.os", system)  # half of the time that two cores take
    monkeypatch.setattr("trainer.bench.beside_peers.install", cant)
    console = Terminal(record=True, width=200)
    files = tmp_path / "peers.json", tmp_path / "peers.png"
    grpc = Peer("ours, gRPC", OURS.module, OURS.package, c=0.3, over_grpc=True)
    run_peers(*files, None, free_port, console, SMALL, [OURS, BROKEN, grpc, SB3, TORCH])
    rows = json.loads(files[0].read_text())["peers"]
    assert [row["name"] for row in rows] == [OURS.name, BROKEN.name, grpc.name, "SB3", "torch"]
    assert rows[1]["problem"] == "nobody's can't be installed: ERROR: none"
    for row in (rows[0], *rows[2:]):
        (found,) = row["cores"].values()
        assert found["steps_per_second"] > 0
        assert found["to_ours"] > 0
        assert 0 < found["cores_used"] < 1.2
        assert found["peak_mb"] > 50
        assert row["install_mb"] > 100
    assert rows[0]["cores"]["1"]["to_ours"] == 1.0
    assert files[1].stat().st_size > 1000
    printed = console.export_text()
    assert "nobody's" in printed
    assert "can't be installed: ERROR: none" in printed


def test_ours_that_cant_be_measured_ends_it(monkeypatch, free_port):
    wrong = Peer("ours", "no_program", "torch")
    with pytest.raises(TrainerError, match="ours ended before it measured anything: .*no_program"):
        next(beside_peers(None, free_port, SMALL, [wrong]))


def test_other_interpreters_import_the_corridor_and_the_programs_alone():
    with importable() as variables:
        assert installed(sys.executable, "numpy", variables)["version"] == np.__version__
        held = {path.name for path in Path(variables["PYTHONPATH"]).rglob("*") if not path.is_symlink()}
    assert held == {"trainer", "bench", "__init__.py"}
