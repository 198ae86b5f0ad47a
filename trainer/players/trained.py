"""Agents as a run trains on them: what its learners have no use for ends the run where it first shows.

That is of runs in lockstep, whose policies can't keep to masks, and take vectors and one kind of action. The wrappers
give all of that to others, and every other run learns from it (``Scene``).
"""

from typing import Any

import gymnasium
from mlagents_envs.base_env import DecisionSteps
from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from trainer.corridor import episode_info
from trainer.players.behavior import only_behavior
from trainer.players.gym_wrapper import Observation, UnityToGymWrapper
from trainer.players.unsupported import refuse_masks
from trainer.players.vec_env import UnityVecEnv, observation_space


class TrainedSlots(UnityVecEnv):
    """Every agent as a slot, of a behavior that observes vectors and masks nothing.

    Args:
        environment: The environment; closing this closes it.
        statistics: The environment's statistics channel.

    Raises:
        TrainerError: The behavior observes other things than vectors, has continuous and discrete actions at once, or
            masks a choice.
    """

    def __init__(self, environment: UnityEnvironment, statistics: StatsSideChannel | None = None) -> None:
        observation_space(only_behavior(environment)[1])  # or none that it takes
        super().__init__(environment, statistics)
        refuse_masks(self.agents.decision)

    def reset(self) -> VecEnvObs:
        """Begins an episode in every slot.

        Raises:
            TrainerError: An agent masks a choice.
        """
        observations = super().reset()
        refuse_masks(self.agents.decision)
        return observations

    def step_wait(self) -> VecEnvStepReturn:
        """Runs the player until every slot's agent asks for its next decision.

        Raises:
            TrainerError: An agent masks a choice.
        """
        stepped = super().step_wait()
        refuse_masks(self.agents.decision)
        return stepped


class EpisodeStatistics(gymnasium.Wrapper[Observation, Any, Observation, Any]):
    """Adds what the player reported of an ended episode to its last info, as ``statistics`` and ``is_success``.

    The info's ``step`` goes: Stable-Baselines3's ``DummyVecEnv`` would copy it at every step.

    Args:
        env: The environment of one agent.
        channel: The statistics channel that the player's environment was opened with.
    """

    def __init__(self, env: UnityToGymWrapper, channel: StatsSideChannel) -> None:
        super().__init__(env)
        self._channel = channel

    def step(self, action: Any) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Steps the environment.

        Raises:
            TrainerError: The agent masks a choice.
        """
        observation, reward, terminated, truncated, info = self.env.step(action)
        self._take(info)
        received = self._channel.get_and_reset_stats()
        if terminated or truncated:
            info.update(episode_info({name: values[-1][0] for name, values in received.items()}))
        return observation, float(reward), terminated, truncated, info

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Resets the environment.

        Raises:
            TrainerError: The agent masks a choice.
        """
        observation, info = self.env.reset(seed=seed, options=options)
        self._take(info)
        return observation, info

    def _take(self, info: dict[str, Any]) -> None:
        steps = info.pop("step")
        if isinstance(steps, DecisionSteps):
            refuse_masks(steps)
