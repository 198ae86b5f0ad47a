"""What agents of one behavior did, agent by agent, until it is learned from: the collector's memory.

Agents need not be in step. A transition begins when an agent asked and got its action, and is closed by its next
request or by its episode's end, whenever that comes. Transitions of one agent's episode make a trajectory, which the
episode's end closes, and which the time horizon and an update cut: the value function estimates what would follow.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from corridor_server.protocol.agents import Agents, Behavior
from trainer.learning.transitions import Decided, EndedEpisode, Indices, Observed, Rows, Singles, Transitions

Agent = tuple[int, str, int]  # player, full name of the behavior, id
_NONE = -1
_OF_A_SLOT = ("open", "last", "asked", "age", "lengths", "episode")


class Experience:
    """The open and the closed transitions of a behavior's agents.

    Args:
        behavior: What they observe and do.
        time_horizon: Transitions after which a trajectory is cut.

    Attributes:
        closed: How many transitions are closed.
        ended: Episodes that ended since this was last emptied by its reader.
    """

    def __init__(self, behavior: Behavior, time_horizon: int) -> None:
        self._time_horizon = time_horizon
        choices, branches = sum(behavior.discrete_branches), len(behavior.discrete_branches)
        self._observations = [Rows(each.shape) for each in behavior.sensors]
        self._allowed = Rows((choices,), np.bool_)
        self._columns = {
            "continuous": Rows((behavior.continuous_actions,)),
            "discrete": Rows((branches,), np.int64),
            "log_probs": Rows(()),
            "rewards": Rows((), np.float32),
            "seen": Rows((), np.intp),  # the observation's row
            "next_seen": Rows((), np.intp),  # -1 while the transition is open
            "previous": Rows((), np.intp),
            "episodes": Rows((), np.intp),
            "terminated": Rows((), np.bool_),
        }
        self.closed = 0
        self.ended: list[EndedEpisode] = []
        self._masked = False
        self._agents: dict[Agent, int] = {}
        self._free: list[int] = []
        self._episodes = 0  # numbers given so far
        # By slot, one for each agent in an episode: its open transition, the one before, and the observation that it
        # asked with last; -1 for none. Of its trajectory and its episode, what there is so far.
        self._slots: dict[str, NDArray[Any]] = {name: np.zeros(0, np.intp) for name in _OF_A_SLOT}
        self._slots["totals"] = np.zeros(0)

    def __len__(self) -> int:
        """How many transitions there are, closed and open."""
        return len(self._columns["rewards"])

    @property
    def running(self) -> set[int]:
        """The numbers of the episodes that agents are in."""
        return set(self._slots["episode"][list(self._agents.values())].tolist())

    def begin_anew(self, player: int) -> None:
        """Forgets the running episodes of a player that says no more of them."""
        for agent in [each for each in self._agents if each[0] == player]:
            slot = self._agents.pop(agent)
            self._drop(slot)

    def end(self, player: int, behavior: str, agents: Agents, observations: tuple[Singles, ...]) -> Indices:
        """Closes the transitions of agents whose episode ended.

        Args:
            player: Whose agents they are.
            behavior: Their full name, with the team.
            agents: Those that ended.
            observations: Their last ones, as a policy takes them.

        Returns:
            The transition of each, (n,); -1 for an agent that had not decided anything.
        """
        slots = [self._agents.pop((player, behavior, agent), _NONE) for agent in agents.ids.tolist()]
        known = np.array(slots, np.intp)
        which = known >= 0
        transitions = np.full(len(known), _NONE, np.intp)
        if which.any():
            chosen = known[which]
            transitions[which] = self._close(chosen, _rewards(agents)[which], _some(observations, which))
            closed = transitions >= 0
            self._columns["terminated"].values[transitions[closed]] = ~agents.interrupted[closed]
            for slot in chosen.tolist():
                number, total, length = (self._slots[name][slot] for name in ("episode", "totals", "lengths"))
                self.ended.append(EndedEpisode(int(number), float(total), int(length)))
                self._drop(slot)
        return transitions

    def ask(self, player: int, behavior: str, agents: Agents, observed: Observed, again: bool = False) -> "Asking":
        """Closes the transitions of agents that ask for their next decision, and takes what they observe.

        Args:
            player: Whose agents they are.
            behavior: Their full name, with the team.
            agents: Those that ask.
            observed: What they observe, as a policy takes it.
            again: Whether this was taken before: of a run that goes on where it was saved.
        """
        known = self._agents
        slots = np.array(
            [
                slot
                if (slot := known.get((player, behavior, agent), _NONE)) >= 0
                else self._enter((player, behavior, agent))
                for agent in agents.ids.tolist()
            ],
            np.intp,
        )
        rows = self._slots["asked"][slots] if again else self._see(observed)
        self._slots["asked"][slots] = rows
        going_on = self._slots["open"][slots] >= 0
        if going_on.any():
            chosen = slots[going_on]
            closed = self._slots["open"][chosen]
            self._finish(chosen, closed, _rewards(agents)[going_on], rows[going_on])
            self._slots["last"][chosen] = closed
            self._slots["age"][chosen] += 1
            cut = chosen[self._slots["age"][chosen] >= self._time_horizon]
            self._slots["last"][cut], self._slots["age"][cut] = _NONE, 0
        self._slots["open"][slots] = _NONE
        return Asking(slots, rows)

    def act(self, asking: "Asking", decided: Decided) -> None:
        """Begins a transition for each agent that asked.

        Args:
            asking: What ``ask`` gave.
            decided: What they do.
        """
        count, columns = len(asking.slots), self._columns
        begun = np.arange(len(self), len(self) + count)
        columns["continuous"].append(decided.continuous)
        columns["discrete"].append(decided.discrete)
        columns["log_probs"].append(decided.log_probs)
        columns["rewards"].append(np.zeros(count, np.float32))
        columns["seen"].append(asking.rows)
        columns["next_seen"].append(np.full(count, _NONE, np.intp))
        columns["previous"].append(self._slots["last"][asking.slots])
        columns["episodes"].append(self._slots["episode"][asking.slots])
        columns["terminated"].append(np.zeros(count, np.bool_))
        self._slots["open"][asking.slots] = begun

    def take(self, asking: Sequence["Asking"] = ()) -> tuple[Transitions, list["Asking"]]:
        """Takes the closed transitions out; every running trajectory is cut here.

        Args:
            asking: Of agents that wait for their action: their rows move.

        Returns:
            The transitions, and ``asking`` with its rows where they are now.
        """
        columns = {name: column.used for name, column in self._columns.items()}
        closed = np.flatnonzero(columns["next_seen"] >= 0)
        place = np.full(len(self), _NONE, np.intp)
        place[closed] = np.arange(len(closed))
        previous = columns["previous"][closed]
        previous = np.where(previous >= 0, place[previous], _NONE)
        seen, next_seen = columns["seen"][closed], columns["next_seen"][closed]
        used, places = np.unique(np.concatenate((seen, next_seen)), return_inverse=True)
        seen_place, next_seen_place = np.split(places, 2)
        taken = Transitions(
            tuple(each.used[used] for each in self._observations),
            seen_place,
            next_seen_place,
            self._allowed.used[seen] if self._masked else None,
            Decided(*(columns[name][closed] for name in ("continuous", "discrete", "log_probs"))),
            columns["rewards"][closed],
            previous,
            columns["episodes"][closed],
            columns["terminated"][closed],
        )
        return taken, self._keep_open(asking)

    def state_dict(self) -> dict[str, Any]:
        """All of it, between two messages: arrays, and ``agents`` (player, behavior, id and slot of each)."""
        arrays = {f"observations_{index}": each.used for index, each in enumerate(self._observations)}
        arrays |= {name: each.used for name, each in self._columns.items()}
        arrays |= {f"slot_{name}": each for name, each in self._slots.items()}
        plain = {
            "agents": [[*agent, slot] for agent, slot in self._agents.items()],
            "free": list(self._free),
            "numbers": [self._episodes, self.closed],
            "masked": self._masked,
        }
        return {**arrays, "allowed": self._allowed.used, **plain}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Goes on in the middle of episodes, with what ``state_dict`` gave.

        Raises:
            KeyError: Something is missing.
        """
        for index, each in enumerate(self._observations):
            each.fill(state[f"observations_{index}"])
        for name, column in self._columns.items():
            column.fill(state[name])
        self._allowed.fill(state["allowed"])
        self._slots = {name: state[f"slot_{name}"].copy() for name in self._slots}
        self._agents = {(player, behavior, agent): slot for player, behavior, agent, slot in state["agents"]}
        self._free, self._masked = list(state["free"]), state["masked"]
        self._episodes, self.closed = state["numbers"][:2]

    def _enter(self, agent: Agent) -> int:
        if not self._free:
            size = len(self._slots["open"])
            more = max(size, 16)
            self._free = list(range(size + more - 1, size - 1, -1))
            for name, former in self._slots.items():
                self._slots[name] = np.concatenate([former, np.full(more, _NONE, former.dtype)])
        slot = self._free.pop()
        self._agents[agent] = slot
        for name in ("open", "last", "asked"):
            self._slots[name][slot] = _NONE
        self._slots["age"][slot] = self._slots["lengths"][slot] = 0
        self._slots["totals"][slot] = 0.0
        self._slots["episode"][slot] = self._episodes
        self._episodes += 1
        return slot

    def _drop(self, slot: int) -> None:
        self._slots["open"][slot] = _NONE
        self._free.append(slot)

    def _close(self, slots: Indices, rewards: Singles, observations: tuple[Singles, ...]) -> Indices:
        """Closes what has an open transition, with last observations; -1 for what has none."""
        transitions: Indices = self._slots["open"][slots]
        which = transitions >= 0
        if which.any():
            rows = self._see(Observed(_some(observations, which)))
            self._finish(slots[which], transitions[which], rewards[which], rows)
        return transitions

    def _finish(self, slots: Indices, transitions: Indices, rewards: Singles, rows: Indices) -> None:
        self._columns["rewards"].values[transitions] = rewards
        self._columns["next_seen"].values[transitions] = rows
        self._slots["totals"][slots] += rewards
        self._slots["lengths"][slots] += 1
        self.closed += len(slots)

    def _see(self, observed: Observed) -> Indices:
        count, first = len(observed), len(self._observations[0])
        for rows, values in zip(self._observations, observed.observations, strict=True):
            rows.append(values)
        allowed = observed.allowed
        self._masked |= allowed is not None
        if self._masked or self._allowed.shape[0]:
            self._allowed.append(np.ones((count, *self._allowed.shape), np.bool_) if allowed is None else allowed)
        return np.arange(first, first + count)

    def _keep_open(self, asking: Sequence["Asking"]) -> list["Asking"]:
        """Moves open transitions, and what is still to be acted on, to the beginning; forgets the rest."""
        columns, slots = self._columns, self._slots
        running = np.array(list(self._agents.values()), np.intp)
        waiting = running[slots["open"][running] >= 0]
        kept = slots["open"][waiting]
        rows = np.concatenate([columns["seen"].used[kept], *(each.rows for each in asking)])
        for each in (*self._observations, self._allowed):
            if len(each):
                each.keep(rows)
        for column in columns.values():
            column.keep(kept)
        columns["seen"].used[:] = np.arange(len(kept))
        columns["previous"].used[:] = _NONE
        slots["open"][waiting] = np.arange(len(kept))
        slots["last"][:] = slots["asked"][:] = _NONE
        slots["age"][:] = 0
        self.closed = 0
        moved, start = [], len(kept)
        for asking_slots, former in asking:
            places = np.arange(start, start + len(former))
            slots["asked"][asking_slots] = places
            moved.append(Asking(asking_slots, places))
            start += len(former)
        return moved


class Asking(NamedTuple):
    """Agents that wait for an action.

    Attributes:
        slots: Of each, (n,).
        rows: Where what it observes is kept, (n,).
    """

    slots: Indices
    rows: Indices


def _rewards(agents: Agents) -> Singles:
    """An agent's own and its group's."""
    return agents.rewards + agents.group_rewards


def _some(observations: tuple[Singles, ...], which: NDArray[np.bool_]) -> tuple[Singles, ...]:
    return observations if which.all() else tuple(each[which] for each in observations)
