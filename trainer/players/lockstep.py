"""Agents of one behavior that decide in step, each in a slot of its own: what every vector environment stands on."""

from collections.abc import Collection
from typing import Any, NamedTuple

import numpy as np
from mlagents_envs.base_env import ActionTuple, DecisionSteps, TerminalSteps
from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel
from numpy.typing import NDArray

from trainer.corridor import episode_info
from trainer.errors import TrainerError
from trainer.players.behavior import only_behavior
from trainer.players.behavior_spaces import ObservationLayout, all_rewards, allowed_choices
from trainer.players.environment import in_two_halves
from trainer.players.failures import BadNumbers
from trainer.players.owned import compressed_pictures
from trainer.players.unsupported import refuse_other_behaviors


class End(NamedTuple):
    """An episode that ended.

    Attributes:
        slot: Whose.
        observation: Its last, a row of each of the layout's parts.
        interrupted: Whether a limit cut it, instead of its own end.
        reported: What the player's statistics say of it, as ``episode_info`` gives it.
    """

    slot: int
    observation: list[NDArray[np.float32]]
    interrupted: bool
    reported: dict[str, Any]


class Lockstep:
    """Every agent of the one behavior is a slot.

    A slot's next episode is its own agent's, where agents keep their ids as Unity's do; where a player gives every
    episode another id, it is whichever new agent takes the ended one's place.

    Args:
        environment: The environment; closing this closes it.
        statistics: The environment's statistics channel. Where a player sends one value per ended episode, the
            episode's end has them.
        channels_first: Give pictures as (channels, height, width) instead of (height, width, channels).

    Attributes:
        behavior: The name of the behavior.
        spec: What its agents observe and do.
        layout: How they observe.
        count: How many slots there are.
        decision: What the agents showed last when they asked, in their order.
        observations: What every slot shows, (slots, *shape) for each of the layout's parts.

    Raises:
        TrainerError: There are several behaviors, or one that observes nothing.
    """

    def __init__(
        self, environment: UnityEnvironment, statistics: StatsSideChannel | None, channels_first: bool = False
    ) -> None:
        self.environment = environment
        self._closed = False
        self._step = in_two_halves(environment)
        self._statistics = statistics
        self.behavior, self.spec = only_behavior(environment)
        self.layout = ObservationLayout(self.spec, compressed_pictures(environment, self.behavior), channels_first)
        self._fresh = True  # only_behavior's reset began an episode that the first reset() gives out
        self._dropped = 0  # agents that ended before their first decision, since statistics were last attributed
        self.decision: DecisionSteps = self._first_decisions()
        self.count = len(self.decision)
        self._slots: dict[int, int] = {}
        self._begin(self.decision)

    def reset(self) -> None:
        """Begins an episode in every slot.

        Raises:
            TrainerError: More or fewer agents ask than before.
        """
        if not self._fresh:
            self.environment.reset()
        self._fresh = False
        decision = self._first_decisions()
        if len(decision) != self.count:
            raise TrainerError(
                f"{len(decision)} agents asked for a decision after a reset, but {self.count} did before."
            )
        self._begin(decision)
        self._take_statistics()

    def send(self, numbers: NDArray[np.float32], choices: NDArray[np.int32]) -> None:
        """Hands actions to the player, in the order in which its agents asked.

        Args:
            numbers: Of each slot, (slots, continuous size).
            choices: Of each slot, (slots, branches).

        Raises:
            TrainerError: A number is NaN or infinite.
        """
        self._fresh = False
        _check_finite(numbers)
        self.environment.set_actions(self.behavior, ActionTuple(numbers[self._in_order], choices[self._in_order]))
        self._step.send()  # the player computes while others get their actions

    def receive(self) -> tuple[NDArray[np.float32], list[End]]:
        """Runs the player until every slot's agent asks for its next decision.

        Returns:
            Each slot's reward, with its group's, (slots,), and the episodes that ended: an ended slot's reward is its
            last episode's, and it shows its next one already.

        Raises:
            TrainerError: The agents do not decide in step, or others came beside them.
        """
        rewards = np.zeros(self.count, dtype=np.float32)
        ended: dict[int, int] = {}  # slots by the agents whose episodes ended
        ends: list[End] = []
        receive = self._step.receive
        while True:
            try:
                receive()
            except BadNumbers as error:
                area = None if error.agent is None else (self._slots | ended).get(error.agent)
                raise error if area is None else error.in_area(area) from error
            receive = self.environment.step  # while no agent asks for a decision, there is nothing to send
            refuse_other_behaviors(self.environment.behavior_specs, self.behavior)
            decision, terminal = self.environment.get_steps(self.behavior)
            if len(terminal):
                self._end_episodes(terminal, rewards, ended, ends)
            if len(decision):
                break
        self.decision = decision
        self._take_decisions(decision, rewards, ended)
        return rewards, self._attribute_statistics(ends)

    def allowed(self) -> NDArray[np.bool_]:
        """Which choices each slot has now, (slots, all branches' choices one after another); True is allowed."""
        allowed = np.empty((self.count, sum(self.spec.action_spec.discrete_branches)), np.bool_)
        allowed[self._in_order] = allowed_choices(self.spec.action_spec, self.decision)
        return allowed

    def close(self) -> None:
        """Closes the environment; a second time has no effect."""
        if not self._closed:
            self._closed = True
            self.environment.close()

    def _begin(self, decision: DecisionSteps) -> None:
        """Gives every agent that asks a slot, in their order."""
        self.decision, self._agent_ids = decision, decision.agent_id
        self._slots = {agent: slot for slot, agent in enumerate(decision.agent_id.tolist())}
        self._in_order: NDArray[np.intp] = np.arange(len(decision))
        self.observations = [part.copy() for part in self.layout.parts(decision)]

    def _first_decisions(self) -> DecisionSteps:
        """After a reset, what the agents show that ask first: Unity may have messages before, without any that asks."""
        decision, _ = self.environment.get_steps(self.behavior)
        while not len(decision):
            self.environment.step()
            decision, _ = self.environment.get_steps(self.behavior)
        return decision

    def _end_episodes(
        self, terminal: TerminalSteps, rewards: NDArray[np.float32], ended: dict[int, int], ends: list[End]
    ) -> None:
        last_observations, last_rewards = self.layout.parts(terminal), all_rewards(terminal)
        for row, agent in enumerate(terminal.agent_id.tolist()):
            slot = self._slots.pop(agent, None)
            if slot is None:  # it ended before its first decision, of which ML-Agents makes no episode either
                self._dropped += 1
                continue
            rewards[slot] = last_rewards[row]
            ended[agent] = slot
            ends.append(End(slot, [part[row] for part in last_observations], bool(terminal.interrupted[row]), {}))

    def _take_decisions(self, decision: DecisionSteps, rewards: NDArray[np.float32], ended: dict[int, int]) -> None:
        if not ended and np.array_equal(decision.agent_id, self._agent_ids):
            rewards[self._in_order] = all_rewards(decision)
            self._show(decision)
            return
        agents = decision.agent_id.tolist()
        new = [agent for agent in agents if agent not in self._slots]
        if len(new) != len(ended) or len(set(agents)) != self.count:
            silent = self._slots.keys() - set(agents)
            raise TrainerError(
                f"The {self.count} agents of the first message are to decide in step, but in a later one agents "
                f"{_listed(agents)} asked for a decision, and of the others {_listed(silent)} neither asked nor ended; "
                "give all DecisionRequesters of the scene the same period and offset, and keep the number of agents."
            )
        kept = {agent: ended[agent] for agent in new if agent in ended}
        successors = [agent for agent in new if agent not in ended]
        self._slots |= kept
        self._slots.update(zip(successors, sorted(set(ended.values()) - set(kept.values())), strict=True))
        self._agent_ids = decision.agent_id
        self._in_order = np.array([self._slots[agent] for agent in agents], dtype=np.intp)
        self._show(decision)
        running = ~np.isin(self._in_order, list(ended.values()))
        rewards[self._in_order[running]] = all_rewards(decision)[running]

    def _show(self, decision: DecisionSteps) -> None:
        for shown, part in zip(self.observations, self.layout.parts(decision), strict=True):
            shown[self._in_order] = part

    def _attribute_statistics(self, ends: list[End]) -> list[End]:
        received, dropped, self._dropped = self._take_statistics(), self._dropped, 0
        if dropped:
            return ends  # which of the values were a dropped agent's can't be told
        # A name without exactly one value per episode can't be attributed.
        whole = {name: values for name, values in received.items() if len(values) == len(ends)}
        return [
            end._replace(reported=episode_info({name: values[row] for name, values in whole.items()}))
            for row, end in enumerate(ends)
        ]

    def _take_statistics(self) -> dict[str, list[float]]:
        if self._statistics is None:
            return {}
        received = self._statistics.get_and_reset_stats()
        return {name: [value for value, _ in values] for name, values in received.items()}


def _listed(agents: Collection[int]) -> str:
    first = ", ".join(map(str, sorted(agents)[:5]))
    return f"{first}{', ...' * (len(agents) > 5)}" if agents else "none"


def _check_finite(numbers: NDArray[np.float32]) -> None:
    """Refuses actions that no player should simulate.

    Raises:
        TrainerError: One is NaN or infinite; the message names the slot.
    """
    finite = np.isfinite(numbers)
    if not finite.all():
        slot = int(np.argwhere(~finite)[0][0])
        raise TrainerError(
            f"The action for area {slot} is {numbers[slot].tolist()}, but finite numbers were expected; the policy "
            "has diverged: try a smaller learning rate."
        )
