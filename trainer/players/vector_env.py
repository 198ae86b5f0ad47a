"""An ML-Agents environment with many agents as a ``gymnasium.vector.VectorEnv``: one sub-environment per agent."""

from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel
from numpy.typing import NDArray

from corridor_server.shared.given import shown
from trainer.errors import TrainerError
from trainer.players.behavior_spaces import Observation, action_arrays, action_mask, action_space
from trainer.players.lockstep import End, Lockstep
from trainer.players.owned import CLOSED, closed_if_refused


class UnityVectorEnv(VectorEnv[Observation, Any, NDArray[Any]]):
    """Every agent of the one behavior is a sub-environment; ``Lockstep`` says which agent has which.

    Works for a behavior whose agents ask for decisions in step. Players begin next episodes by themselves, so
    ``metadata["autoreset_mode"]`` is ``AutoresetMode.SAME_STEP``: where an episode ended, the observation is the next
    one's first, and ``infos`` has the last one's as ``final_obs``, and what the player said of it as ``final_info``.
    ``terminations`` and ``truncations`` are never both true: an interrupted episode is truncated.

    Vector observations alone are one Box, one after another; any others a Dict of all, ``obs_0``, ``obs_1``, ..., all
    float32, pictures (height, width, channels), compressed ones from 0 to 1. Actions are a Box, Discrete,
    MultiDiscrete, or, of both kinds, Tuple((Box, MultiDiscrete)). With discrete ones, ``infos`` has ``action_mask``,
    int8, 1 for what is allowed, of each agent as ``single_action_space.sample`` takes it: (agents, choices) for
    Discrete, otherwise an array (agents,) of tuples. A reward is the agent's own with its group's added.

    Args:
        environment: The environment; closing this closes it, and so does a refusal of it.
        statistics: The environment's statistics channel. Where a player sends one value per ended episode, its
            ``final_info`` has them as ``statistics``, and ``is_success`` if the player reports success.

    Raises:
        TrainerError: There are several behaviors, or one that observes or does nothing.
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.SAME_STEP}  # noqa: RUF012 - Gymnasium's own

    def __init__(self, environment: UnityEnvironment, statistics: StatsSideChannel | None = None) -> None:
        with closed_if_refused(environment):
            self._agents = Lockstep(environment, statistics)
            self._action_spec = self._agents.spec.action_spec
            self.single_action_space = action_space(self._action_spec)
        self.num_envs = self._agents.count
        self.single_observation_space = self._agents.layout.space
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
            TrainerError: ``reset_mask`` is none, or leaves an agent out; or the environment is closed.
        """
        if self.closed:
            raise TrainerError(CLOSED)
        _check_options(options, self.num_envs)
        super().reset(seed=seed)
        self._agents.reset()
        return self._observations(), self._infos([])

    def step(self, actions: Any) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Gives every agent its action and runs the player until all ask for the next.

        Returns:
            Observations, rewards (agents,) float32, terminations and truncations (agents,) bool, and infos.

        Raises:
            TrainerError: An action is NaN or infinite, the agents do not decide in step, or the environment is closed.
        """
        if self.closed:
            raise TrainerError(CLOSED)
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

    def _masks(self) -> NDArray[Any]:
        allowed = self._agents.allowed()
        if isinstance(self.single_action_space, spaces.Discrete):
            return allowed.astype(np.int8)
        masks = np.empty(self.num_envs, dtype=object)
        for slot, row in enumerate(allowed):
            masks[slot] = action_mask(self._action_spec, row)
        return masks

    def _infos(self, ends: list[End]) -> dict[str, Any]:
        infos: dict[str, Any] = {}
        for end in ends:
            final = {"final_obs": self._agents.layout.value(end.observation), "final_info": end.reported}
            infos = self._add_info(infos, final, end.slot)
        if self._action_spec.discrete_size:
            infos["action_mask"] = self._masks()
            infos["_action_mask"] = np.ones(self.num_envs, np.bool_)
        return infos


def _check_options(options: Any, count: int) -> None:
    """Refuses options that a reset can't keep to.

    Raises:
        TrainerError: They are no dict, or ``reset_mask`` is not True for each of so many agents.
    """
    if options is not None and not isinstance(options, dict):
        raise TrainerError(f"options is {shown(options)}, but a dict or None was expected; leave it out.")
    if not options or "reset_mask" not in options:
        return
    mask = options["reset_mask"]
    if not (isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.shape == (count,) and mask.all()):
        raise TrainerError(
            f"reset_mask is {shown(mask)}, but an array of {count} bools, True for every agent, was expected: a player "
            "resets all or none, and begins the next episode of an agent by itself; leave it out."
        )
