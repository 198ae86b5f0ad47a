"""An ML-Agents environment with many agents as a Stable-Baselines3 ``VecEnv``: one slot per area."""

from functools import partial
from typing import Any

import numpy as np
from gymnasium import spaces
from mlagents_envs.base_env import BehaviorSpec
from mlagents_envs.environment import UnityEnvironment
from mlagents_envs.side_channel.stats_side_channel import StatsSideChannel
from numpy.typing import NDArray
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from trainer.errors import TrainerError
from trainer.players import behavior_spaces
from trainer.players.behavior_spaces import ObservationLayout, action_arrays, sees_vectors
from trainer.players.lockstep import Lockstep
from trainer.players.owned import CLOSED, closed_if_refused
from trainer.players.slots import Slots

MASKS = "action_masks"  # as sb3-contrib's MaskablePPO asks for them


class UnityVecEnv(Slots):
    """Every agent of the one behavior is a slot; ``Lockstep`` says which agent has which.

    Works for a behavior whose agents ask for decisions in step, with either continuous or discrete actions. ``done``
    follows SB3: an ended slot shows its next episode's first observation, its info the last one's
    ``terminal_observation`` and ``TimeLimit.truncated``. A reward is the agent's own with its group's added.

    Vector observations alone are one Box, one after another. Any others are a Dict of all, ``obs_0``, ``obs_1``, ...,
    for SB3's ``MultiInputPolicy``: float32, because a byte could not hold every picture exactly; pictures are
    (channels, height, width), compressed ones from 0 to 1, and go through a convolutional network with
    ``normalize_images=False`` in ``policy_kwargs`` (SB3's own wants 36 x 36 or more), and flat without.

    With discrete actions, ``env_method("action_masks")`` gives each slot's mask, (all branches' choices one after
    another,) bool, True for a choice that is allowed, and ``has_attr("action_masks")`` is true.

    Args:
        environment: The environment; closing this closes it, and so does a refusal of it.
        statistics: The environment's statistics channel. Where a player sends one value per ended episode, the
            episode's info has them as ``statistics``, and ``is_success`` if the player reports success.

    Attributes:
        agents: The slots' agents.

    Raises:
        TrainerError: The behavior observes nothing, or has continuous and discrete actions at once.
    """

    def __init__(self, environment: UnityEnvironment, statistics: StatsSideChannel | None = None) -> None:
        self.environment = environment
        self._closed = False
        with closed_if_refused(environment):
            self.agents = Lockstep(environment, statistics, channels_first=True)
            self._action_spec = self.agents.spec.action_spec
            super().__init__(self.agents.count, self.agents.layout.space, action_space(self.agents.spec))

    def reset(self) -> VecEnvObs:
        """Begins an episode in every slot.

        Raises:
            TrainerError: The environment is closed.
        """
        self._check_open()
        self.agents.reset()
        self.reset_infos = [{} for _ in range(self.num_envs)]
        return self._observations()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Hands the actions to the player, in the order in which its agents asked.

        Raises:
            TrainerError: An action is NaN or infinite, or the environment is closed.
        """
        self._check_open()
        self.agents.send(*action_arrays(self._action_spec, actions, self.num_envs))

    def step_wait(self) -> VecEnvStepReturn:
        """Runs the player until every slot's agent asks for its next decision."""
        rewards, ends = self.agents.receive()
        dones = np.zeros(self.num_envs, dtype=np.bool_)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for end in ends:
            dones[end.slot] = True
            infos[end.slot] = {
                "terminal_observation": self.agents.layout.value(end.observation),
                "TimeLimit.truncated": end.interrupted,
                **end.reported,
            }
        return self._observations(), rewards, dones, infos

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """For each slot, what ``Slots`` has, and the method ``action_masks`` with discrete actions.

        Raises:
            AttributeError: It is another attribute, which an agent doesn't have.
        """
        if attr_name == MASKS and self._action_spec.discrete_size:
            return [partial(self._mask, slot) for slot in self._get_indices(indices)]
        return super().get_attr(attr_name, indices)

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Each slot's ``action_masks``, with discrete actions.

        Raises:
            AttributeError: It is another method; use a side channel.
        """
        if method_name == MASKS and self._action_spec.discrete_size:
            allowed = self.agents.allowed()
            return [allowed[slot] for slot in self._get_indices(indices)]
        return super().env_method(method_name, *args, indices=indices, **kwargs)

    def close(self) -> None:
        """Closes the environment; a second time has no effect."""
        self._closed = True
        self.agents.close()

    def _check_open(self) -> None:
        if self._closed:
            raise TrainerError(CLOSED)

    def _mask(self, slot: int) -> NDArray[np.bool_]:
        mask: NDArray[np.bool_] = self.agents.allowed()[slot]
        return mask

    def _observations(self) -> VecEnvObs:
        return self.agents.layout.value([part.copy() for part in self.agents.observations])


def observation_space(spec: BehaviorSpec) -> spaces.Box:
    """Several vectors, one after another, for runs in lockstep, which learn from vectors alone.

    Raises:
        TrainerError: There is another observation, or none.
    """
    space = ObservationLayout(spec).space if sees_vectors(spec) else None
    if not isinstance(space, spaces.Box):
        shapes = [tuple(observation.shape) for observation in spec.observation_specs]
        raise TrainerError(
            f"A run with --preset, --algo or --from-sb3 takes vector observations, not shapes {shapes}; leave these "
            "options out."
        )
    return space


def action_space(spec: BehaviorSpec) -> spaces.Space[Any]:
    """Box for continuous actions, Discrete for one discrete branch, MultiDiscrete for several.

    Raises:
        TrainerError: There are both kinds, which Stable-Baselines3 has no policy for.
    """
    action = spec.action_spec
    if action.continuous_size and action.discrete_size:
        raise TrainerError(
            f"The behavior has {action.continuous_size} continuous actions and {action.discrete_size} discrete "
            "branches, but Stable-Baselines3's policies take one kind; corridor train takes both without --preset, "
            "--algo and --from-sb3."
        )
    return behavior_spaces.action_space(action)
