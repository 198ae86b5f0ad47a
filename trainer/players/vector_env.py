"""An ML-Agents environment with many agents as a ``gymnasium.vector.VectorEnv``: one sub-environment per agent."""

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel
from numpy.typing import NDArray

from trainer.errors import TrainerError
from trainer.players.behavior_spaces import Observation, action_arrays, action_space
from trainer.players.lockstep import End, Lockstep


class UnityVectorEnv(VectorEnv[Observation, Any, NDArray[Any]]):
    """Every agent of the one behavior is a sub-environment; ``Lockstep`` says which agent has which.

    Works for a behavior whose agents ask for decisions in step. Players begin next episodes by themselves, so
    ``metadata["autoreset_mode"]`` is ``AutoresetMode.SAME_STEP``: where an episode ended, the observation is the next
    one's first, and ``infos`` has the last one's as ``final_obs``, and what the player said of it as ``final_info``.
    ``terminations`` and ``truncations`` are never both true: an interrupted episode is truncated.

    Vector observations alone are one Box, one after another; any others a Dict of all, ``obs_0``, ``obs_1``, ..., all
    float32, pictures (height, width, channels) from 0 to 1. Actions are a Box, Discrete, MultiDiscrete, or, of both
    kinds, Tuple((Box, MultiDiscrete)); with discrete ones, ``infos`` has ``action_mask``, (agents, all branches'
    choices one after another) int8, 1 for what is allowed. A reward is the agent's own with its group's added.

    Args:
        environment: The environment; closing this closes it.
        statistics: The environment's statistics channel. Where a player sends one value per ended episode, its
            ``final_info`` has them as ``statistics``, and ``is_success`` if the player reports success.

    Raises:
        TrainerError: There are several behaviors, or one that observes or does nothing.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 - Gymnasium's own

    def __init__(self, environment: UnityEnvironment, statistics: StatsSideChannel | None = None) -> None:
        self._agents = Lockstep(environment, statistics)
        self._action_spec = self._agents.spec.action_spec
        self.num_envs = self._agents.count
        self.single_observation_space = self._agents.layout.space
        self.single_action_space = action_space(self._action_spec)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins an episode for every agent.

        Args:
            seed: Reaches only this environment's own generator: a player takes its seed when it is opened.
            options: Gymnasium's ``reset_mask`` has to name every agent, as a player resets all or none.

        Raises:
            TrainerError: ``reset_mask`` leaves an agent out.
        """
        super().reset(seed=seed)
        if options is not None and not np.all(options.get("reset_mask", True)):
            raise TrainerError(
                f"reset_mask is {options['reset_mask']}, but True for every agent was expected: a player resets all or "
                "none, and begins the next episode of an agent by itself."
            )
        self._agents.reset()
        return self._observations(), self._infos([])

    def step(self, actions: Any) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Gives every agent its action and runs the player until all ask for the next.

        Returns:
            Observations, rewards (agents,) float32, terminations and truncations (agents,) bool, and infos.

        Raises:
            TrainerError: An action is NaN or infinite, or the agents do not decide in step.
        """
        self._agents.send(*action_arrays(self._action_spec, actions, self.num_envs))
        rewards, ends = self._agents.receive()
        terminations, truncations = np.zeros(self.num_envs, np.bool_), np.zeros(self.num_envs, np.bool_)
        for end in ends:
            (truncations if end.interrupted else terminations)[end.slot] = True
        return self._observations(), rewards, terminations, truncations, self._infos(ends)

    def close_extras(self, **kwargs: Any) -> None:
        """Closes the environment."""
        self._agents.close()

    def _observations(self) -> Observation:
        return self._agents.layout.value([part.copy() for part in self._agents.observations])

    def _infos(self, ends: list[End]) -> dict[str, Any]:
        infos: dict[str, Any] = {}
        for end in ends:
            final = {"final_obs": self._agents.layout.value(end.observation), "final_info": end.reported}
            infos = self._add_info(infos, final, end.slot)
        if self._action_spec.discrete_size:
            infos["action_mask"] = self._agents.allowed().astype(np.int8)
            infos["_action_mask"] = np.ones(self.num_envs, np.bool_)
        return infos
