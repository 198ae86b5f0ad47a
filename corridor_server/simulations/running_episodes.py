"""Running episodes written down, to be played again: what each began with, and the actions since.

Hardly an environment can be saved in the middle of an episode. But one that draws from random generators that can be
seen plays the same episode again, if they stand where they stood and the same actions come. Whether it did is looked
at afterwards.
"""

import hashlib
import itertools
import json
import logging
import random
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agents import ActionBatch, Agents
from corridor_server.protocol.side_channels import OF_ANY_LENGTH
from corridor_server.simulations.environment_memory import Memory, Remembered, array_of, plain
from corridor_server.simulations.simulation import Moment, NotRestored, Simulation

logger = logging.getLogger(__name__)

_MOST_STEPS = 20_000  # of a running episode
Settings = Mapping[str, float] | None
Step = Mapping[str, tuple[NDArray[np.int32], ActionBatch]]  # by behavior, who acted and what they did
Begin = Callable[[int, int | None, Settings], object]  # an episode in this copy, with a seed and settings


class ActionsTaken(NamedTuple):
    """What the agents of one behavior did, over all steps.

    Attributes:
        steps: When, (n,) int64.
        ids: Who, (n,) int32.
        actions: What, a row each.
    """

    steps: NDArray[np.int64]
    ids: NDArray[np.int32]
    actions: ActionBatch

    def of(self, ids: Sequence[int], step: int) -> "ActionsTaken":
        """What these did from a step on."""
        mine = np.isin(self.ids, ids) & (self.steps >= step)
        return ActionsTaken(
            self.steps[mine], self.ids[mine], ActionBatch(self.actions.continuous[mine], self.actions.discrete[mine])
        )


class _Begun(NamedTuple):
    """How a copy's running episode began.

    Attributes:
        step: When.
        seed: Its own; None goes on with the random numbers of the one before.
        settings: Its own.
        before: The settings of the episode before; None if it is the copy's first one.
        remembered: By the copy, before.
    """

    step: int
    seed: int | None
    settings: Settings
    before: Settings
    remembered: Remembered


class RunningEpisodes:
    """The running episodes of copies of an environment that were just made.

    Args:
        identity: What the copies were made of; a state of others is not taken up.
        memories: Of each copy.
    """

    def __init__(self, identity: Sequence[object], memories: Sequence[Memory]) -> None:
        self._identity = repr(identity)
        self._memories = memories
        self._fresh = memories[0].now().plain()  # what is as there is not written down of each copy
        self._began: list[_Begun | None] = [None] * len(memories)
        self._written: list[str | None] = [None] * len(memories)  # of each beginning, once it was asked for
        self._steps: deque[Step] = deque(maxlen=_MOST_STEPS)  # the latest
        self._step = 0
        self._of_process = _randoms_of_the_process()
        self._told_why = False

    def begin(self, copy: int, seed: int | None, settings: Settings) -> None:
        """Notes that a copy is about to begin an episode."""
        former = self._began[copy]
        before = None if former is None else former.settings or {}
        self._began[copy] = _Begun(self._step, seed, settings, before, self._memories[copy].now())
        self._written[copy] = None
        if former is not None and former.step <= self._step - len(self._steps):  # it may have been the oldest
            oldest = min(each.step for each in self._began if each is not None)
            while self._step - len(self._steps) < oldest:
                self._steps.popleft()

    def began_at(self, copy: int) -> int:
        """The step at which a copy's running episode began; 0 before its first one."""
        began = self._began[copy]
        return 0 if began is None else began.step

    def act(self, ids: Mapping[str, NDArray[np.int32]], actions: Mapping[str, ActionBatch]) -> None:
        """Notes that all copies are about to take a step.

        Args:
            ids: Of the agents that act, by behavior.
            actions: Theirs.
        """
        self._steps.append({name: (each, actions[name]) for name, each in ids.items()})
        self._step += 1

    def snapshot(self, last: Moment, extra: Mapping[str, Any]) -> NDArray[np.void] | None:
        """All of it as bytes; None if the episodes could not be played again from it.

        Args:
            last: Whom the copies ask now.
            extra: Plain values of the simulation's own.
        """
        if not self._can_be_played_again():
            return None
        for copy, began in enumerate(self._began):
            if self._written[copy] is None and began is not None:
                self._written[copy] = json.dumps((*began[:-1], began.remembered.plain(but=self._fresh)))
        rest = json.dumps(
            {
                "identity": self._identity,
                "fresh": self._fresh,
                "first": self._step - len(self._steps),
                "step": self._step,
                "acted": {name: plain(tuple(_flat(acted))) for name, acted in self._acted().items()},
                "now": self._digest(last),
                **extra,
            }
        )
        text = f"[{rest}, [{', '.join(each or 'null' for each in self._written)}]]"
        return np.frombuffer(text.encode(), OF_ANY_LENGTH)

    def take_up(self, rows: NDArray[np.void], begin: Begin) -> tuple[dict[str, ActionsTaken], Mapping[str, Any]]:
        """Takes up what ``snapshot`` gave, and begins the episodes once more; their actions have still to be played.

        Args:
            rows: Those.
            begin: Called of each copy for its first episode, and for the running one if that is another.

        Returns:
            What was done in them, by behavior, and the simulation's own values.

        Raises:
            NotRestored: They are of other copies, or of another form.
        """
        saved, begun = json.loads(rows.tobytes())
        if saved["identity"] != self._identity or len(begun) != len(self._memories):
            raise NotRestored("it was saved with another environment or other arguments")
        acted = {name: _unflat(parts) for name, parts in saved["acted"].items()}
        self._step, self._fresh = saved["step"], saved["fresh"]
        self._steps.extend(_by_steps(acted, saved["first"], self._step))
        for copy, (memory, fields) in enumerate(zip(self._memories, begun, strict=True)):
            step, seed, settings, before, remembered = fields
            if before is not None:
                begin(copy, 0, before)  # some objects are only made with the first episode
            memory.put_back({**self._fresh, **remembered})
            self._began[copy] = _Begun(step, seed, settings, before, memory.now())
            self._written[copy] = json.dumps(fields)
            begin(copy, seed, settings)
        return acted, saved

    def check(self, last: Moment, saved: Mapping[str, Any]) -> None:
        """Looks whether the episodes are what they were.

        Args:
            last: Whom the copies ask now.
            saved: As ``take_up`` gave it.

        Raises:
            NotRestored: They are not.
        """
        if self._digest(last) != saved["now"]:
            raise NotRestored("played once more, its episodes are others")

    def _can_be_played_again(self) -> bool:
        why = ""
        if _randoms_of_the_process() != self._of_process:
            why = "the environment draws from random generators of the whole process, which nobody can put back"
        elif any(began is not None and began.step < self._step - len(self._steps) for began in self._began):
            why = f"an episode has more than {_MOST_STEPS:,} steps"
        why = why or self._hidden()
        if why and not self._told_why:
            logger.warning("The running episodes can't be saved, as %s: a resumed run will begin new ones.", why)
            self._told_why = True
        return not why

    def _hidden(self) -> str:
        for memory, began in zip(self._memories, self._began, strict=True):
            if began is not None and began.before is not None:  # with the first episode, everything was new
                name = memory.opaque_of(began.remembered)
                if name is not None:
                    return f"{name} is compiled code's, lives on in the next episode, and may remember the last one"
        return ""

    def _acted(self) -> dict[str, ActionsTaken]:
        first = self._step - len(self._steps)
        parts: dict[str, list[tuple[int, NDArray[np.int32], ActionBatch]]] = {}
        for number, step in enumerate(self._steps, first):
            for name, (ids, actions) in step.items():
                parts.setdefault(name, []).append((number, ids, actions))
        return {
            name: ActionsTaken(
                np.repeat([number for number, _, _ in found], [len(ids) for _, ids, _ in found]),
                np.concatenate([ids for _, ids, _ in found]),
                ActionBatch(
                    np.concatenate([actions.continuous for _, _, actions in found]),
                    np.concatenate([actions.discrete for _, _, actions in found]),
                ),
            )
            for name, found in parts.items()
        }

    def _digest(self, moment: Moment) -> str:
        """Of what all agents that are asked see, and of where random generators stand."""
        digest = hashlib.sha256()
        for agents in moment.values():
            if len(asking := agents.deciding):
                for values in _told(asking):
                    digest.update(np.ascontiguousarray(values).tobytes())
        for memory in self._memories:
            digest.update(json.dumps(memory.randoms()).encode())
        return digest.hexdigest()


class PlaysAgain(Simulation):
    """A simulation whose state is its running episodes, which are played again.

    Attributes:
        _episodes: Its running ones; None if they are not kept.
        _seeds: Of each copy's next episode; None goes on with the random numbers of the one before.
    """

    is_checked = True
    _episodes: RunningEpisodes | None
    _seeds: list[int | None]

    def forgo_snapshots(self) -> None:
        """Keeps no running episodes: looking at what a copy remembers takes longer than many a step."""
        self._episodes = None

    def restore(self, rows: NDArray[np.void]) -> None:
        """Plays the episodes again.

        Raises:
            NotRestored: They can't be, or are others then.
        """
        try:
            self._play_again(rows)
        except Exception as error:  # whatever an author's code raises
            self._renew()
            self._seeds = _other_seeds(rows, len(self._seeds))
            raise _not_restored(error) from error
        self.restored = True

    @abstractmethod
    def _play_again(self, rows: NDArray[np.void]) -> None:
        """Begins the saved episodes, and plays them to where they were."""

    @abstractmethod
    def _renew(self) -> None:
        """Makes the copies anew."""


def _not_restored(error: Exception) -> NotRestored:
    """Why episodes can't be played again, of what went wrong."""
    if isinstance(error, NotRestored):
        return error
    return NotRestored(f"{type(error).__name__}: {' '.join(str(error).split())[:300]}")


def _other_seeds(rows: NDArray[np.void], count: int) -> list[int | None]:
    """Seeds of episodes that were not played yet, for copies that can't go on from this state."""
    words = np.frombuffer(hashlib.sha256(rows.tobytes()).digest(), np.uint32)
    return list(np.random.default_rng(words).integers(2**32, size=count).tolist())


def _told(agents: Agents) -> Iterable[NDArray[Any]]:
    # Who ended in the same message decides which part of a reward counts as the group's.
    return agents.ids, agents.rewards + agents.group_rewards, *agents.observations, *agents.masks


def _by_steps(acted: Mapping[str, ActionsTaken], first: int, end: int) -> Sequence[Step]:
    steps: list[dict[str, tuple[NDArray[np.int32], ActionBatch]]] = [{} for _ in range(first, end)]
    for name, (numbers, ids, (continuous, discrete)) in acted.items():
        edges = np.searchsorted(numbers, np.arange(first, end + 1)).tolist()
        for step, (start, stop) in zip(steps, itertools.pairwise(edges), strict=True):
            if stop > start:
                step[name] = ids[start:stop], ActionBatch(continuous[start:stop], discrete[start:stop])
    return steps


def _flat(acted: ActionsTaken) -> Iterable[NDArray[Any]]:
    return acted.steps, acted.ids, *acted.actions


def _unflat(parts: Sequence[Any]) -> ActionsTaken:
    steps, ids, continuous, discrete = map(array_of, parts)
    return ActionsTaken(steps, ids, ActionBatch(continuous, discrete))


def _randoms_of_the_process() -> tuple[object, ...]:
    return random.getstate(), json.dumps(plain(np.random.get_state(legacy=False)))  # noqa: NPY002 - as others may use it
