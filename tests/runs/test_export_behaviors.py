"""``corridor export`` of behaviors of every kind: ML-Agents' names, and in onnxruntime the actions that players got."""

from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from conftest import BIN, corridor_here
from exported import FLOAT, INT, session
from exported import form as exported_form

from corridor_server.protocol.agents import Agents, Behavior, Sensor
from trainer.behavior_settings import BehaviorSettings
from trainer.commands.train import Train
from trainer.config import RunConfig
from trainer.errors import TrainerError
from trainer.learning.learner import Learner
from trainer.learning.ppo_learner import PPOLearner
from trainer.learning.rewards import build_signals
from trainer.learning.sac_learner import SACLearner
from trainer.runs import onnx_graph
from trainer.runs.behavior_learners import LEARNER, plain_behavior
from trainer.runs.checkpoint import CheckpointWriter, to_bytes
from trainer.runs.counters import Counters
from trainer.runs.folder import RunFolder
from trainer.runs.onnx_check import check_graph
from trainer.runs.onnx_learner import learner_as_onnx
from trainer.runs.run_state import capture

ROWS = 128
VECTOR, MORE = Sensor.of("vector", (4,)), Sensor.of("more", (3,))
PICTURE, UNITYS_PICTURE = Sensor.of("camera", (20, 24, 3)), Sensor("camera", (3, 20, 24), (1, 2, 2))
SQUARE = Sensor.of("camera", (36, 36, 1))
BUFFER, GOAL = Sensor.of("buffer", (5, 3)), Sensor("goal", (2,), (1,), 1)
MASKS = ("action_masks", ["batch", 5], FLOAT)
ALWAYS = [("version_number", [1], FLOAT), ("memory_size", [1], FLOAT)]
CONTINUOUS = [
    ("continuous_actions", ["batch", 2], FLOAT),
    ("continuous_action_output_shape", [1], FLOAT),
    ("deterministic_continuous_actions", ["batch", 2], FLOAT),
]
DISCRETE = [
    ("discrete_actions", ["batch", 2], INT),
    ("discrete_action_output_shape", [1, 2], FLOAT),
    ("deterministic_discrete_actions", ["batch", 2], INT),
]
# What mlagents-learn 1.1.0 exports of the same specs; it calls the first dimension of the deterministic ones otherwise.
FORMS = {
    "continuous": (
        Behavior("Any", (VECTOR, MORE), 2),
        [("obs_0", ["batch", 4], FLOAT), ("obs_1", ["batch", 3], FLOAT)],
        CONTINUOUS,
    ),
    "discrete": (Behavior("Any", (VECTOR,), 0, (3, 2)), [("obs_0", ["batch", 4], FLOAT), MASKS], DISCRETE),
    "hybrid": (Behavior("Any", (VECTOR,), 2, (3, 2)), [("obs_0", ["batch", 4], FLOAT), MASKS], CONTINUOUS + DISCRETE),
    "picture": (
        Behavior("Any", (PICTURE, VECTOR), 2),
        [("obs_0", ["batch", 3, 20, 24], FLOAT), ("obs_1", ["batch", 4], FLOAT)],
        CONTINUOUS,
    ),
    "picture, channels first": (
        Behavior("Any", (UNITYS_PICTURE,), 2),
        [("obs_0", ["batch", 3, 20, 24], FLOAT)],
        CONTINUOUS,
    ),
    "buffer alone": (Behavior("Any", (BUFFER,), 2), [("obs_0", ["batch", 5, 3], FLOAT)], CONTINUOUS),
    "everything": (
        Behavior("Any", (BUFFER, VECTOR, PICTURE, GOAL), 2, (3, 2)),
        [
            ("obs_0", ["batch", 5, 3], FLOAT),
            ("obs_1", ["batch", 4], FLOAT),
            ("obs_2", ["batch", 3, 20, 24], FLOAT),
            ("obs_3", ["batch", 2], FLOAT),
            MASKS,
        ],
        CONTINUOUS + DISCRETE,
    ),
}
EVERY_KIND = pytest.mark.parametrize(("behavior", "inputs", "outputs"), FORMS.values(), ids=FORMS)


def drawn(behavior: Behavior) -> tuple[np.ndarray, ...]:
    """Vectors about 5, the first one far away; pictures; and buffers of 0, 1, ... entities."""
    rng, found = np.random.default_rng(0), []
    for sensor in behavior.sensors:
        values = rng.random((ROWS, *sensor.shape)) if sensor.is_picture else rng.normal(5.0, 2.0, (ROWS, *sensor.shape))
        if len(sensor.shape) == 1:
            values[0] = 1000.0
        if sensor.name == "buffer":
            values[np.arange(5) >= np.arange(ROWS)[:, None] % 6] = 0.0
        found.append(values.astype(np.float32))
    return tuple(found)


def forbidden(branches: tuple[int, ...]) -> tuple[np.ndarray, ...]:
    """Of each branch one choice of the first ones in turn, none for the agents at the end."""
    turns = np.arange(ROWS)[:, None] % 3
    return tuple((np.arange(size) == turns) & (np.arange(ROWS)[:, None] < ROWS - 10) for size in branches)


def learner_of(behavior: Behavior, *, normalize: bool = True, **network: object) -> PPOLearner:
    """A learner whose actions depend on what its agents observe, and with statistics as after training."""
    settings = BehaviorSettings()
    own = replace(settings.network_settings, normalize=normalize, hidden_units=16, **network)
    settings = replace(settings, network_settings=own)
    torch.manual_seed(1)
    learner = PPOLearner(behavior, settings, build_signals(behavior, settings, 0), 0)
    with torch.no_grad():
        learner.policy.action_net.weight.mul_(5.0)
    learner.observations.learn(Agents.that_ask(np.arange(1, ROWS), tuple(each[1:] for each in drawn(behavior)), []))
    return learner


def asking(behavior: Behavior) -> Agents:
    ids = np.arange(ROWS)
    return Agents.that_ask(ids, drawn(behavior), np.zeros(ROWS), forbidden(behavior.discrete_branches))


def as_unity_gives(behavior: Behavior) -> dict[str, np.ndarray]:
    feed = {}
    for place, (sensor, values) in enumerate(zip(behavior.sensors, drawn(behavior), strict=True)):
        turned = sensor.is_picture and sensor is not UNITYS_PICTURE
        feed[f"obs_{place}"] = np.transpose(values, (0, 3, 1, 2)) if turned else values
    if behavior.discrete_branches:
        feed["action_masks"] = 1.0 - np.concatenate(forbidden(behavior.discrete_branches), axis=1).astype(np.float32)
    return feed


def equals(program: bytes, learner: Learner) -> None:
    """The most likely actions are those that a player gets; forbidden choices are neither they nor sampled."""
    behavior, model = learner.behavior, session(program)
    learner.play()
    learner.take(0, "Any", None, asking(behavior))
    expected = learner.act()[0, "Any"]
    names = [node.name for node in model.get_outputs()]
    found = dict(zip(names, model.run(None, as_unity_gives(behavior)), strict=True))
    assert (found["version_number"].tolist(), found["memory_size"].tolist()) == ([3.0], [0.0])
    if behavior.continuous_actions:
        assert found["continuous_action_output_shape"].tolist() == [2.0]
        assert expected.continuous.std() > 0.02
        assert np.abs(found["deterministic_continuous_actions"] - expected.continuous).max() <= 1e-5
        assert np.abs(found["continuous_actions"]).max() <= 1.0
        assert np.ptp(found["continuous_actions"] - expected.continuous) > 0.5, "they are sampled"
    if behavior.discrete_branches:
        assert found["discrete_action_output_shape"].tolist() == [[3.0, 2.0]]
        assert np.array_equal(found["deterministic_discrete_actions"], expected.discrete)
        for branch, masked in enumerate(forbidden(behavior.discrete_branches)):
            assert len(np.unique(expected.discrete[:, branch])) > 1
            for name in ("discrete_actions", "deterministic_discrete_actions"):
                assert not masked[np.arange(ROWS), found[name][:, branch]].any()


@EVERY_KIND
def test_names_order_shapes_and_types_are_those_of_mlagents_learn(behavior, inputs, outputs):
    program = learner_as_onnx(learner_of(behavior))
    assert exported_form(session(program).get_inputs()) == inputs
    assert exported_form(session(program).get_outputs()) == ALWAYS + outputs
    assert [(each.domain, each.version) for each in onnx.load_from_string(program).opset_import] == [("", 9)]


@EVERY_KIND
def test_actions_are_those_that_players_got(behavior, inputs, outputs):
    learner = learner_of(behavior)
    equals(learner_as_onnx(learner), learner)


@pytest.mark.parametrize("vis_encode_type", ["nature_cnn", "resnet", "match3", "fully_connected"])
def test_every_encoder_of_pictures(vis_encode_type):
    learner = learner_of(Behavior("Any", (SQUARE,), 2), vis_encode_type=vis_encode_type)
    equals(learner_as_onnx(learner), learner)


@pytest.mark.parametrize("form", ["continuous", "picture", "buffer alone"])
def test_the_actions_of_sac_are_squashed_and_their_deviations_what_it_sees(form):
    behavior, inputs, outputs = FORMS[form]
    settings = BehaviorSettings.from_mapping(
        {
            "trainer_type": "sac",
            "hyperparameters": {"buffer_size": 200},
            "network_settings": {"normalize": True, "hidden_units": 16},
        }
    )
    torch.manual_seed(1)
    learner = SACLearner(behavior, settings, build_signals(behavior, settings, 0))
    with torch.no_grad():
        learner.policy.actor.mu.weight.mul_(20.0)
    learner.observations.learn(Agents.that_ask(np.arange(1, ROWS), tuple(each[1:] for each in drawn(behavior)), []))
    program = learner_as_onnx(learner)
    assert exported_form(session(program).get_inputs()) == inputs
    assert exported_form(session(program).get_outputs()) == ALWAYS + outputs
    equals(program, learner)


def test_goal_signals_beside_the_others_and_vectors_as_they_are():
    learner = learner_of(Behavior("Any", (VECTOR, GOAL), 2), normalize=False, goal_conditioning_type="none")
    equals(learner_as_onnx(learner), learner)


@EVERY_KIND
def test_unity_can_load_it_which_runs_it_on_zeros_once(behavior, inputs, outputs):
    """On masks of zeros, too, which forbid everything."""
    model = session(learner_as_onnx(learner_of(behavior)))
    zeros = {name: np.zeros([1, *shape[1:]], np.float32) for name, shape, _ in inputs}
    for node, found in zip(model.get_outputs(), model.run(None, zeros), strict=True):
        assert np.isfinite(found).all()
        if node.name.endswith("discrete_actions"):
            assert (found >= 0).all()
            assert (found < behavior.discrete_branches).all()


def test_a_graph_that_forgets_masks_is_not_written(monkeypatch):
    monkeypatch.setattr(onnx_graph, "BLOCKED", 0.0)
    with pytest.raises(TrainerError, match="makes choices that are masked; it was not written"):
        learner_as_onnx(learner_of(Behavior("Any", (VECTOR,), 0, (3, 2))))


@pytest.mark.parametrize("actions", [(2, ()), (0, (3, 2))])
def test_a_graph_of_another_policy_is_not_written(monkeypatch, actions):
    behavior, other = Behavior("Any", (VECTOR,), *actions), []
    monkeypatch.setattr("trainer.runs.onnx_learner.check_graph", lambda *checked: other.append(checked))
    for normalize in (True, False):
        learner_as_onnx(learner_of(behavior, normalize=normalize))
    (program, *_), (_, *against) = other
    with pytest.raises(TrainerError, match=r"differs from the run's by \d.*; it was not written"):
        check_graph(program, *against)


class Plain:
    def __init__(self, values: dict) -> None:
        self.values = values

    def state_dict(self) -> dict:
        return self.values


def saved_run(path: Path, *behaviors: Behavior) -> Path:
    """A run's folder as training on such behaviors leaves it."""
    config: RunConfig = Train("any").run_config()
    learners = {}
    for behavior in behaviors:
        name = behavior.name.partition("?")[0]
        settings = config.settings_for(name)
        learners[name] = PPOLearner(behavior, settings, build_signals(behavior, settings, 0), 0)
    plain = {name: plain_behavior(learner.behavior) for name, learner in learners.items()}
    path.mkdir()
    folder = RunFolder(path)
    folder.record_scene(config, {each["name"]: each for each in plain.values()}, 1)
    parts = {"behaviors": Plain(plain), **{f"{LEARNER}{name}": learner for name, learner in learners.items()}}
    facts = {"config": config.as_dict(), "counters": asdict(Counters()), "env_steps": 0}
    CheckpointWriter(folder.checkpoints).write(0, to_bytes(capture(parts, facts)))
    return path


def test_one_behavior_is_the_file(tmp_path):
    run = saved_run(tmp_path / "run", Behavior("Any?team=1", (VECTOR,), 2))
    done = corridor_here("export", run, "--onnx", tmp_path / "Mine.onnx")
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith(f"\nWrote {tmp_path / 'Mine.onnx'}\n")
    assert [each.name for each in tmp_path.glob("*.onnx*")] == ["Mine.onnx"]


def test_of_several_behaviors_each_has_its_file(tmp_path):
    run = saved_run(tmp_path / "run", Behavior("Big Fox?team=0", (VECTOR,), 2), Behavior("Hare", (MORE,), 0, (3,)))
    done = corridor_here("export", run, "--onnx", tmp_path / "Mine.onnx")
    assert done.returncode == 0, done.stderr
    files = {each.name: each for each in tmp_path.glob("*.onnx*")}
    assert files.keys() == {"Mine-Big%20Fox.onnx", "Mine-Hare.onnx"}
    assert all(f"Wrote {each}\n" in done.stdout for each in files.values())
    assert exported_form(session(files["Mine-Hare.onnx"]).get_inputs())[0] == ("obs_0", ["batch", 3], FLOAT)


@pytest.mark.parametrize("command", ["export", "evaluate", "resume", "init_path"])
def test_a_policy_of_before_layers_were_swish_is_refused(tmp_path, monkeypatch, free_port, command):
    monkeypatch.setattr("trainer.runs.checkpoint.FORMAT", 2)
    run = saved_run(tmp_path / "any", Behavior("CartPole-v1", (Sensor.of("observation", (4,)),), 0, (2,)))
    monkeypatch.undo()
    player = ("--base-port", free_port, "--env", BIN / "corridor-server", "--env-args", "--gym", "CartPole-v1")
    settings = tmp_path / "settings.yaml"
    settings.write_text(f"default_settings: {{init_path: '{run}'}}\n")
    done = corridor_here(
        *{
            "export": ("export", run, "--onnx", tmp_path / "Mine.onnx"),
            "evaluate": ("evaluate", run),
            "resume": ("train", "--results-dir", tmp_path, "--run-id", "any", "--resume"),
            "init_path": ("train", settings, "--results-dir", tmp_path, "--run-id", "new", *player),
        }[command]
    )
    assert done.returncode == 1
    assert "has tanh layers, as an earlier version of curious-corridor trains, but swish" in done.stderr
    assert "Traceback" not in done.stderr
    assert ("Starting the player" in done.stderr + done.stdout) == (command == "init_path")


@pytest.mark.slow
def test_a_trained_run_of_two_behaviors_exports(tmp_path, free_port):
    settings = tmp_path / "settings.yaml"
    settings.write_text("default_settings: {hyperparameters: {batch_size: 32, buffer_size: 32}, max_steps: 32}\n")
    served = ("--env", BIN / "corridor-server", "--base-port", free_port)
    given = ("--run-id", "tag", "--results-dir", tmp_path, "--eval-episodes", 1)
    environment = ("--env-args", "--pettingzoo", "mpe2.simple_tag_v3")
    done = corridor_here("train", settings, *given, *served, *environment)
    assert done.returncode == 0, done.stderr
    done = corridor_here("export", tmp_path / "tag", "--onnx", tmp_path / "tag.onnx")
    assert done.returncode == 0, done.stderr
    sizes = {name: session(tmp_path / f"tag-{name}.onnx").get_inputs()[0].shape[1] for name in ("adversary", "agent")}
    assert sizes == {"adversary": 16, "agent": 14}
