"""The learners of a run, one for each behavior that its players have, by names without teams."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from corridor_server.protocol.agents import ActionBatch, Behavior, Sensor
from trainer.config import RunConfig
from trainer.errors import TrainerError
from trainer.learning.device import device_for
from trainer.learning.learner import POLICY, Learner, part_of
from trainer.learning.ppo_learner import PPOLearner
from trainer.learning.rewards import build_signals
from trainer.learning.sac_learner import SACLearner
from trainer.players.scene import Message, Scene
from trainer.runs.checkpoint import Checkpoint, check_layers, read_checkpoint, read_checkpoint_file
from trainer.terminal import Terminal

LEARNER = "learner "  # before a behavior's name, in a checkpoint
VALUE_HEADS = "value_net."  # of a policy's parameters
INTRINSIC = ("curiosity", "rnd")


class BehaviorLearners:
    """Gives every behavior its learner, at its first agents.

    Args:
        config: The run.
        scene: Its players.
    """

    def __init__(self, config: RunConfig, scene: Scene) -> None:
        self._config, self._scene = config, scene
        self._learners: dict[str, Learner] = {}

    def on(self, scene: Scene) -> "BehaviorLearners":
        """The same learners on other players."""
        others = BehaviorLearners(self._config, scene)
        others._learners = self._learners
        return others

    def __iter__(self) -> Iterator[tuple[str, Learner]]:
        return iter(self._learners.items())

    def __len__(self) -> int:
        return len(self._learners)

    @property
    def steps(self) -> int:
        """Of all together."""
        return sum(learner.steps for learner in self._learners.values())

    @property
    def episodes(self) -> int:
        """Of all together."""
        return sum(learner.episodes for learner in self._learners.values())

    @property
    def are_done(self) -> bool:
        """Whether each has taken all its steps."""
        return bool(self._learners) and all(learner.is_done for learner in self._learners.values())

    def may_be_full(self, messages: int = 1) -> bool:
        """Whether so many next messages of every player may bring one enough for an update."""
        return any(learner.may_be_full(messages) for learner in self._learners.values())

    def take(self, messages: list[Message], again: bool = False) -> None:
        """Hands every learner what the players' agents say.

        Args:
            messages: Of each player.
            again: Whether the learners have had them before: of a run that goes on where it was saved.
        """
        for player, message in enumerate(messages):
            self.take_one(player, message, again)

    def take_one(self, player: int, message: Message, again: bool = False) -> None:
        """Hands every learner what one player's agents say."""
        if message.anew:
            for learner in self._learners.values():
                learner.begin_anew(player)
        for name in dict.fromkeys((*message.ended, *message.asking)):
            learner = self._of(self._scene.behaviors[name])
            learner.take(player, name, message.ended.get(name), message.asking.get(name), again)

    def remember(self) -> None:
        """Has every learner begin the transitions of what ``act`` decided."""
        for learner in self._learners.values():
            learner.remember()

    def finish(self) -> bool:
        """Has every learner that has enough for an update end the one that runs beside; returns whether one did."""
        ended = [learner.finish() for learner in self._learners.values() if learner.is_full]
        return any(ended)

    def learn(self) -> bool:
        """Has every learner that has enough make an update; returns whether one is done."""
        done = [learner.learn() for learner in self._learners.values() if learner.is_full]
        return any(done)

    def act(self) -> list[dict[str, ActionBatch]]:
        """Decides for all agents that asked: for each player, by full behavior names."""
        actions: list[dict[str, ActionBatch]] = [{} for _ in range(len(self._scene))]
        for learner in self._learners.values():
            for (player, behavior), batch in learner.act().items():
                actions[player][behavior] = batch
        return actions

    def state_dict(self) -> dict[str, Learner]:
        """Every learner as a part of a checkpoint, by the part's name."""
        return {f"{LEARNER}{name}": learner for name, learner in self._learners.items()}

    def restore(self, checkpoint: Checkpoint, *, to_play: bool = False) -> None:
        """Puts learners back as they were.

        Args:
            checkpoint: Of the run.
            to_play: Only what it takes to act.

        Raises:
            TrainerError: It is for other behaviors.
        """
        for name, described in checkpoint.part("behaviors").items():
            behavior = behavior_from(described)
            self._learners.setdefault(name, _blank(self._config, name, behavior))  # what it began with is in here
            learner = self._of(behavior)
            _load(_state_of(checkpoint, name), name, learner, to_play)

    def described(self) -> dict[str, Any]:
        """What each behavior observes and does, as plain values; the inverse of ``behavior_from``."""
        return {name: plain_behavior(learner.behavior) for name, learner in self._learners.items()}

    def _of(self, behavior: Behavior) -> Learner:
        name = behavior.name.partition("?")[0]
        known = self._learners.get(name)
        if known is None:
            self._learners[name] = known = self._new(name, behavior)
        elif (known.behavior.sensors, known.behavior.continuous_actions, known.behavior.discrete_branches) != (
            behavior.sensors,
            behavior.continuous_actions,
            behavior.discrete_branches,
        ):
            raise TrainerError(
                f"Behavior {behavior.name} observes or does something else than "
                + (
                    "the run's; give the build that it was trained on."
                    if behavior.name == known.behavior.name
                    else f"{known.behavior.name}, but teams of one behavior share a policy; give it another Behavior "
                    "Name."
                )
            )
        return known

    def _new(self, name: str, behavior: Behavior) -> Learner:
        learner = _blank(self._config, name, behavior)
        if learner.settings.init_path is not None:
            path = Path(learner.settings.init_path)
            checkpoint = read_checkpoint(path / "checkpoints") if path.is_dir() else read_checkpoint_file(path)
            state = _state_of(checkpoint, name)
            if isinstance(learner, PPOLearner):
                check_layers(checkpoint, name)
                state = _with_own_values(state, name, learner)
            _load(state, name, learner, to_play=True)
        return learner


def restored_learners(config: RunConfig, checkpoint: Checkpoint) -> dict[str, Learner]:
    """The learners that a checkpoint has, by their behaviors, on the CPU, as far as it takes to act without players.

    Raises:
        TrainerError: They are for other settings.
    """
    learners, config = {}, replace(config, device="cpu")
    for name, described in checkpoint.part("behaviors").items():
        learners[name] = _blank(config, name, behavior_from(described))
        _load(_state_of(checkpoint, name), name, learners[name], to_play=True)
    return learners


def _blank(config: RunConfig, name: str, behavior: Behavior) -> Learner:
    settings, seed = config.settings_for(name), config.seed
    device = device_for(config.device, behavior, settings.network_settings)
    signals = build_signals(behavior, settings, seed, device)
    if settings.trainer_type == "sac":
        return SACLearner(behavior, settings, signals, device)
    return PPOLearner(behavior, settings, signals, seed, device)


def _state_of(checkpoint: Checkpoint, name: str) -> Mapping[str, Any]:
    state = checkpoint.part(f"{LEARNER}{name}")
    if not state:
        raise TrainerError(f"The checkpoint has no behavior {name!r}; give one of a run that trained it.")
    return state


def _with_own_values(state: Mapping[str, Any], name: str, learner: Learner) -> Mapping[str, Any]:
    """Another run's policy for one of other reward signals: actor and layers are as they were, value heads are new."""
    own, given = _heads(learner.weights()), _heads(part_of(state, POLICY))
    signals = {key.partition("/")[0] for key in state} & set(INTRINSIC)  # those of its own making leave their networks
    is_alike = {key: each.shape for key, each in own.items()} == {key: each.shape for key, each in given.items()}
    if is_alike and signals == set(learner.strengths) & set(INTRINSIC):
        return state
    Terminal().print(f"The value heads of {name} begin anew: those of its init_path are for other reward signals.")
    kept = {key: each for key, each in state.items() if key.removeprefix(f"{POLICY}/") not in given}
    return kept | {f"{POLICY}/{key}": each.copy() for key, each in own.items()}


def _heads(weights: Mapping[str, Any]) -> dict[str, Any]:
    return {key: each for key, each in weights.items() if key.startswith(VALUE_HEADS)}


def _load(state: Mapping[str, Any], name: str, learner: Learner, to_play: bool) -> None:
    here, there = (
        {key: each.shape for key, each in weights.items()} for weights in (learner.weights(), part_of(state, POLICY))
    )
    try:
        (learner.load_policy if to_play else learner.load_state_dict)(state)
    except (KeyError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split())[:300]
        for key in here | there:
            if here.get(key) != there.get(key):
                found = f"{key} is {there.get(key, 'not')} there and {here.get(key, 'not')} here"
                reason = f"{found}; give it the network and the trainer_type of that run."
                break
        raise TrainerError(f"The checkpoint's policy of {name} is for other settings: {reason}") from error


def asking_of(messages: list[Message]) -> dict[str, Any]:
    """What the players' agents that ask observe: by this a resumed run knows whether its episodes go on."""
    found: dict[str, Any] = {}
    for player, message in enumerate(messages):
        for name, agents in message.asking.items():
            found[f"{player} {name} ids"] = np.asarray(agents.ids)
            for index, values in enumerate(agents.observations):
                found[f"{player} {name} {index}"] = np.asarray(values)
    return found


def plain_behavior(behavior: Behavior) -> dict[str, Any]:
    """A behavior as plain names and values."""
    return {
        "name": behavior.name,
        "observations": [
            {
                "name": each.name,
                "shape": list(each.shape),
                "properties": list(each.dimension_properties),
                "kind": each.kind,
            }
            for each in behavior.sensors
        ],
        "continuous_actions": behavior.continuous_actions,
        "discrete_branches": list(behavior.discrete_branches),
    }


def behavior_from(values: Mapping[str, Any]) -> Behavior:
    """The inverse of ``plain_behavior``.

    Raises:
        KeyError: Something is missing.
    """
    sensors = tuple(
        Sensor(each["name"], tuple(each["shape"]), tuple(each["properties"]), each["kind"])
        for each in values["observations"]
    )
    return Behavior(values["name"], sensors, values["continuous_actions"], tuple(values["discrete_branches"]))
