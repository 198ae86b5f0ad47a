"""An ML-Agents environment with many agents as a Stable-Baselines3 ``VecEnv``: one slot per area."""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from mlagents_envs.base_env import ActionTuple, BehaviorSpec, DecisionSteps, TerminalSteps
from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from trainer.corridor import episode_info
from trainer.errors import TrainerError
from trainer.players.behavior import only_behavior
from trainer.players.environment import in_two_halves
from trainer.players.failures import BadNumbers
from trainer.players.slots import Slots
from trainer.players.unsupported import refuse_group_rewards, refuse_masks, refuse_other_behaviors


class UnityVecEnv(Slots):
    """Every agent of the one behavior is a slot.

    A slot's next episode is its own agent's, where agents keep their ids as Unity's do; where a player gives every
    episode another id, it is whichever new agent takes the ended one's place.

    Works for a behavior whose agents ask for decisions in step, with vector observations (several are put one after
    another) and either continuous or discrete actions. ``done`` follows SB3: an ended slot shows its next episode's
    first observation, its info the last one's ``terminal_observation`` and ``TimeLimit.truncated``.

    Args:
        environment: The environment; closing this closes it.
        statistics: The environment's statistics channel. Where a player sends one value per ended episode, the
            episode's info has them as ``statistics``, and ``is_success`` if the player reports success.

    Raises:
        TrainerError: The behavior has visual observations, or continuous and discrete actions at once.
    """

    def __init__(self, environment: UnityEnvironment, statistics: StatsSideChannel | None = None) -> None:
        self.environment = environment
        self._closed = False
        self._step = in_two_halves(environment)
        self._statistics = statistics
        self.behavior, spec = only_behavior(environment)
        self._continuous = spec.action_spec.is_continuous()
        self._fresh = True  # only_behavior's reset began an episode that the first reset() gives out
        decision = self._first_decisions()
        super().__init__(len(decision), observation_space(spec), action_space(spec))
        self._slots: dict[int, int] = {}
        self._dropped = 0  # agents that ended before their first decision, since statistics were last attributed
        self._in_order: NDArray[np.intp] = np.arange(self.num_envs)
        self._agent_ids: NDArray[np.int32] = decision.agent_id
        self._observations = np.zeros((self.num_envs, *(self.observation_space.shape or ())), dtype=np.float32)

    def reset(self) -> VecEnvObs:
        """Begins an episode in every slot."""
        if not self._fresh:
            self.environment.reset()
        self._fresh = False
        decision = self._first_decisions()
        if len(decision) != self.num_envs:
            raise TrainerError(
                f"{len(decision)} agents asked for a decision after a reset, but {self.num_envs} did before."
            )
        self._slots = {agent: slot for slot, agent in enumerate(decision.agent_id.tolist())}
        self._agent_ids = decision.agent_id
        self._in_order = np.arange(self.num_envs)
        self._observations = _vector(decision).copy()
        self.reset_infos = [{} for _ in range(self.num_envs)]
        self._take_statistics()
        return self._observations.copy()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Hands the actions to the player, in the order in which its agents asked.

        Raises:
            TrainerError: An action is NaN or infinite.
        """
        self._fresh = False
        chosen = ActionTuple()
        if self._continuous:
            check_finite(actions)
            chosen.add_continuous(actions[self._in_order].astype(np.float32, copy=False))
        else:
            chosen.add_discrete(actions[self._in_order].reshape(self.num_envs, -1).astype(np.int32, copy=False))
        self.environment.set_actions(self.behavior, chosen)
        self._step.send()  # the player computes while others get their actions

    def step_wait(self) -> VecEnvStepReturn:
        """Runs the player until every slot's agent asks for its next decision."""
        rewards = np.zeros(self.num_envs, dtype=np.float32)
        dones = np.zeros(self.num_envs, dtype=np.bool_)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended: dict[int, int] = {}  # slots by the agents whose episodes ended
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
            refuse_group_rewards(terminal)
            ended |= self._end_episodes(terminal, rewards, dones, infos)
            if len(decision):
                break
        refuse_group_rewards(decision)
        refuse_masks(decision)
        self._take_decisions(decision, rewards, dones, ended)
        self._attribute_statistics(list(ended.values()), infos)
        return self._observations.copy(), rewards, dones, infos

    def _first_decisions(self) -> DecisionSteps:
        """After a reset, what the agents show that ask first: Unity may have messages before, without any that asks."""
        decision, _ = self.environment.get_steps(self.behavior)
        while not len(decision):
            self.environment.step()
            decision, _ = self.environment.get_steps(self.behavior)
        refuse_group_rewards(decision)
        refuse_masks(decision)
        return decision

    def _end_episodes(
        self,
        terminal: TerminalSteps,
        rewards: NDArray[np.float32],
        dones: NDArray[np.bool_],
        infos: list[dict[str, Any]],
    ) -> dict[int, int]:
        if not len(terminal):
            return {}
        last_observations = _vector(terminal)
        slots = {}
        for row, agent in enumerate(terminal.agent_id.tolist()):
            slot = self._slots.pop(agent, None)
            if slot is None:  # it ended before its first decision, of which ML-Agents makes no episode either
                self._dropped += 1
                continue
            rewards[slot] = terminal.reward[row]
            dones[slot] = True
            infos[slot]["terminal_observation"] = last_observations[row]
            infos[slot]["TimeLimit.truncated"] = bool(terminal.interrupted[row])
            slots[agent] = slot
        return slots

    def _take_decisions(
        self, decision: DecisionSteps, rewards: NDArray[np.float32], dones: NDArray[np.bool_], ended: dict[int, int]
    ) -> None:
        if not ended and np.array_equal(decision.agent_id, self._agent_ids):
            rewards[self._in_order] = decision.reward
            self._observations[self._in_order] = _vector(decision)
            return
        agents = decision.agent_id.tolist()
        new = [agent for agent in agents if agent not in self._slots]
        if len(new) != len(ended) or len(set(agents)) != self.num_envs:
            silent = self._slots.keys() - set(agents)
            raise TrainerError(
                f"The {self.num_envs} agents of the first message are to decide in step, but in a later one agents "
                f"{_listed(agents)} asked for a decision, and of the others {_listed(silent)} neither asked nor ended; "
                "give all DecisionRequesters of the scene the same period and offset, and keep the number of agents."
            )
        kept = {agent: ended[agent] for agent in new if agent in ended}
        successors = [agent for agent in new if agent not in ended]
        self._slots |= kept
        self._slots.update(zip(successors, sorted(set(ended.values()) - set(kept.values())), strict=True))
        self._agent_ids = decision.agent_id
        self._in_order = np.array([self._slots[agent] for agent in agents], dtype=np.intp)
        self._observations[self._in_order] = _vector(decision)
        running = ~dones[self._in_order]
        rewards[self._in_order[running]] = decision.reward[running]

    def _attribute_statistics(self, ended_slots: list[int], infos: list[dict[str, Any]]) -> None:
        received, dropped, self._dropped = self._take_statistics(), self._dropped, 0
        if dropped:
            return  # which of the values were a dropped agent's can't be told
        # A name without exactly one value per episode can't be attributed.
        whole = {name: values for name, values in received.items() if len(values) == len(ended_slots)}
        for row, slot in enumerate(ended_slots):
            infos[slot].update(episode_info({name: values[row] for name, values in whole.items()}))

    def _take_statistics(self) -> dict[str, list[float]]:
        if self._statistics is None:
            return {}
        received = self._statistics.get_and_reset_stats()
        return {name: [value for value, _ in values] for name, values in received.items()}

    def close(self) -> None:
        """Closes the environment; a second time has no effect."""
        if not self._closed:
            self._closed = True
            self.environment.close()


def _listed(agents: Collection[int]) -> str:
    first = ", ".join(map(str, sorted(agents)[:5]))
    return f"{first}{', ...' * (len(agents) > 5)}" if agents else "none"


def check_finite(actions: NDArray[Any]) -> None:
    """Refuses actions that no player should simulate.

    Raises:
        TrainerError: An action is NaN or infinite; the message names the slot.
    """
    finite = np.isfinite(actions)
    if not finite.all():
        slot = int(np.argwhere(~finite)[0][0])
        raise TrainerError(
            f"The action for area {slot} is {actions[slot].tolist()}, but finite numbers were expected; the policy "
            "has diverged: try a smaller learning rate."
        )


def _vector(steps: DecisionSteps | TerminalSteps) -> NDArray[np.float32]:
    observation = steps.obs[0] if len(steps.obs) == 1 else np.concatenate(steps.obs, axis=1)
    return np.asarray(observation, dtype=np.float32)


def observation_space(spec: BehaviorSpec) -> spaces.Box:
    """Several vectors are put one after another.

    Raises:
        TrainerError: There is another observation, or none.
    """
    shapes: Sequence[tuple[int, ...]] = [tuple(observation.shape) for observation in spec.observation_specs]
    if not shapes or any(len(shape) != 1 for shape in shapes):
        raise TrainerError(f"The vector path takes vector observations, not shapes {shapes}; see UnityToGymWrapper.")
    return spaces.Box(-np.inf, np.inf, (sum(shape[0] for shape in shapes),), np.float32)


def action_space(spec: BehaviorSpec) -> spaces.Space[Any]:
    """Box for continuous actions, Discrete for one discrete branch, MultiDiscrete for several.

    Raises:
        TrainerError: There are both kinds.
    """
    action = spec.action_spec
    if action.is_continuous():
        return spaces.Box(-1.0, 1.0, (action.continuous_size,), np.float32)
    if not action.is_discrete():
        raise TrainerError(
            f"The behavior has {action.continuous_size} continuous actions and {action.discrete_size} discrete "
            "branches; the vector path takes one kind."
        )
    branches = [int(size) for size in action.discrete_branches]
    return spaces.Discrete(branches[0]) if len(branches) == 1 else spaces.MultiDiscrete(branches)
