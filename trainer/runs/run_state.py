"""Everything that decides how a run goes on, captured from its parts for a checkpoint and restored into them.

With the built-in player, whose areas are part of it, a resumed run does what the uncut one would have done, bit for
bit. With a player that can't write its areas down, new episodes begin; all the rest is as it was.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from trainer.errors import TrainerError
from trainer.learning.algorithm_state import LastStep, Optimizer, Policy, Progress, RandomStreams
from trainer.learning.stages import Stages
from trainer.players.slots import Slots
from trainer.runs.checkpoint import Checkpoint
from trainer.runs.counters import Counters


class Captured(Protocol):
    """Something that a run is made of and that can be written down: arrays, and values as JSON has them."""

    def state_dict(self) -> Mapping[str, Any]:
        """All that it remembers; arrays may be views."""


class Part(Captured, Protocol):
    """Something that can also be put back into what was built anew."""

    def load_state_dict(self, state: Any, /) -> None:
        """Takes over what ``state_dict`` gave."""


Parts = Mapping[str, Part]


def trained_parts(stages: Stages) -> Parts:
    """What it takes to play with what was learned."""
    return {"normaliser": stages.normaliser, "policy": Policy(stages.model)}


def learning_parts(stages: Stages, windows: Part, random: RandomStreams) -> Parts:
    """What it takes to go on learning.

    Args:
        stages: The run's.
        windows: The last episodes' numbers.
        random: Restored last, since building stages draws from the streams.
    """
    curious: Parts = {} if stages.curiosity is None else {"curiosity": stages.curiosity}
    model = stages.model
    return {"optimizer": Optimizer(model), **curious, "window": windows, "progress": Progress(model), "random": random}


def episode_parts(stages: Stages) -> Parts:
    """What it takes to go on in the middle of episodes, where the player can."""
    curious: Parts = {} if stages.curiosity is None else {"curiosity_episodes": stages.curiosity.episodes}
    return {"monitor": stages.monitor, **curious, "last_step": LastStep(stages.model)}


def capture(parts: Mapping[str, Captured], facts: Mapping[str, Any]) -> Checkpoint:
    """A run's state between two rollouts; the arrays are views where they can be.

    Args:
        parts: All of them; the next rollout's first actions may have been sent.
        facts: Further plain values.

    Raises:
        TrainerError: A loss is NaN or infinite.
    """
    arrays, plain = {}, dict[str, dict[str, Any]]()
    for part, each in parts.items():
        for name, value in each.state_dict().items():
            if isinstance(value, np.ndarray):
                arrays[f"{part}/{name}"] = np.ascontiguousarray(value) if value.ndim else value
            else:
                plain.setdefault(part, {})[name] = value
    return Checkpoint(arrays, {**facts, "parts": plain})


def restore(checkpoint: Checkpoint, parts: Parts) -> None:
    """Puts a checkpoint's state back into parts that were built with the same settings.

    Raises:
        TrainerError: The checkpoint is of another form.
    """
    for name, part in parts.items():
        try:
            part.load_state_dict(checkpoint.part(name))
        except (KeyError, ValueError, RuntimeError) as error:
            reason = " ".join(str(error).split())[:300]
            raise TrainerError(f"The checkpoint is for other settings: {reason}") from error


def restore_trained(checkpoint: Checkpoint, stages: Stages, algo: str) -> None:
    """Puts the policy and the normaliser's statistics into freshly built stages.

    Raises:
        TrainerError: They are another algorithm's, or for other observations, actions or sizes.
    """
    theirs = checkpoint.facts["config"]["algo"]
    if theirs != algo:
        raise TrainerError(f"The checkpoint is of a run with --algo {theirs}, but this one has {algo}.")
    restore(checkpoint, trained_parts(stages))


def restore_episodes(checkpoint: Checkpoint, stages: Stages, players: Slots) -> bool:
    """Lets the running episodes go on, where the players have shown that theirs do; otherwise new ones begin."""
    if not players.continues(checkpoint.part("players")):
        return False
    restore(checkpoint, episode_parts(stages))
    return True


@dataclass(frozen=True)
class Resumed:
    """What a run has to know before its players are opened; without values, of a run that begins.

    Attributes:
        counters: What it has done so far.
        lives: For each player, how often one was started before.
        states: What each player needs to go on where it was; None if a player could not say.
    """

    counters: Counters = field(default_factory=Counters)
    lives: list[int] | None = None
    states: list[bytes] | None = None


def resumed_from(checkpoint: Checkpoint, num_envs: int) -> Resumed:
    """What a checkpoint says of a run that goes on.

    Raises:
        TrainerError: It has another number of players.
    """
    counters, players = Counters(**checkpoint.facts["counters"]), checkpoint.part("players")
    lives: list[int] = players["lives"]
    if len(lives) != num_envs:
        raise TrainerError(f"The checkpoint is of a run with {len(lives)} players, but --num-envs is {num_envs}.")
    known = [players[name].tobytes() for number in range(len(lives)) if (name := f"state_{number}") in players]
    states = known if len(known) == len(lives) else None
    if states is None:  # with its former seed, a player would play the run's first episodes once more
        lives = [life + 1 for life in lives]
    return Resumed(replace(counters, resumes=counters.resumes + 1), lives, states)
