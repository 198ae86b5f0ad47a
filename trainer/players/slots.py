"""What every vector environment of training areas is, and what a run asks of it."""

from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices


class Slots(VecEnv):
    """A ``VecEnv`` whose slots are training areas, which have no attributes or methods that a caller could reach.

    What a run asks of its players stands here too, with the answers of slots that have none behind them.
    """

    @property
    def exchange_seconds(self) -> float:
        """Time spent exchanging messages with players."""
        return 0.0

    @property
    def restarts(self) -> int:
        """How often a player was started again."""
        return 0

    def ask_states(self) -> None:
        """Has every player that can send its areas' state with its answer to the next step."""

    def state_dict(self) -> dict[str, Any]:
        """Where the players are: ``lives``, and what it takes to go on from there, as far as they say."""
        return {"lives": []}

    def continues(self, state: Mapping[str, Any]) -> bool:
        """Whether the episodes go on that were running when ``state_dict`` gave this; begins new ones otherwise."""
        return False

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """None for each slot, which says that it was not seeded: a player takes its seed when it is opened."""
        return [None] * self.num_envs

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """For each slot, what it has in common with Gymnasium's environments: its spaces and ``render_mode``.

        Raises:
            AttributeError: It is another attribute, which an area doesn't have.
        """
        match attr_name:
            case "render_mode":
                value: Any = None
            case "observation_space" | "action_space":
                value = getattr(self, attr_name)
            case _:
                raise AttributeError(f"An area has no attribute {attr_name}.")
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Not supported.

        Raises:
            AttributeError: Always; use a side channel.
        """
        raise AttributeError(f"An area has no attribute {attr_name} to set; use a side channel.")

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Not supported.

        Raises:
            AttributeError: Always; use a side channel.
        """
        raise AttributeError(f"An area has no method {method_name} to call; use a side channel.")

    def env_is_wrapped(self, wrapper_class: type[gymnasium.Wrapper], indices: VecEnvIndices = None) -> list[bool]:
        """Never: slots are not Gymnasium environments."""
        return [False for _ in self._get_indices(indices)]
