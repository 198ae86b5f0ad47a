"""The corridor in process as Stable-Baselines3's ``VecEnv``, for SB3, for SBX, and for ours."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvStepReturn

from trainer.bench.peers.corridor_arrays import CorridorArrays
from trainer.bench.peers.peer_settings import PeerSettings
from trainer.bench.peers.turns import Turns

FOR_EVER = 10**12


class CorridorSlots(VecEnv):
    """Every area is a slot.

    Args:
        corridor: The areas.
    """

    def __init__(self, corridor: CorridorArrays) -> None:
        self.corridor = corridor
        self._actions = np.zeros((len(corridor), corridor.action_size), np.float32)
        observed = spaces.Box(-np.inf, np.inf, (corridor.size,), np.float32)
        super().__init__(len(corridor), observed, spaces.Box(-1.0, 1.0, (corridor.action_size,), np.float32))

    def reset(self) -> NDArray[np.float32]:
        """Begins an episode in every slot."""
        return self.corridor.reset()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Keeps the actions for ``step_wait``."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Steps every area."""
        stepped = self.corridor.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for area, last in zip(stepped.ended.tolist(), stepped.last_observations, strict=True):
            infos[area] = {"terminal_observation": last, "TimeLimit.truncated": bool(stepped.truncated[area])}
        return stepped.observations, stepped.rewards, stepped.terminated | stepped.truncated, infos

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """None for each: the corridor has a seed of its own."""
        return [None] * self.num_envs

    def close(self) -> None:
        """Nothing is open."""

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Each slot's; an area has a ``render_mode`` of None, and no other attribute."""
        if attr_name != "render_mode":
            raise AttributeError(f"An area has no attribute {attr_name}.")
        return [None for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Not supported."""
        raise AttributeError(f"An area has no attribute {attr_name}.")

    def env_method(self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any) -> list[Any]:
        """Not supported."""
        raise AttributeError(f"An area has no method {method_name}.")

    def env_is_wrapped(self, wrapper_class: Any, indices: VecEnvIndices = None) -> list[bool]:
        """Never."""
        return [False for _ in self._get_indices(indices)]


class TakeTurns(BaseCallback):
    """Has an algorithm with SB3's callbacks learn in turns.

    Args:
        warm_up: Updates before anything is measured.
        corridor: Counts rewards, where it is in process.
    """

    def __init__(self, warm_up: int, corridor: CorridorArrays | None = None) -> None:
        super().__init__()
        self._turns = Turns(warm_up)
        self._corridor = corridor
        self._over = False

    def _on_rollout_start(self) -> None:
        reward = 0.0 if self._corridor is None else self._corridor.reward
        loss = float(self.logger.name_to_value.get("train/value_loss", math.nan))
        # In process, the corridor has the last word on how many steps there were.
        steps = self.num_timesteps if self._corridor is None else self._corridor.steps
        self._over = not self._turns.goes_on(steps, reward, loss)

    def _on_step(self) -> bool:
        return not self._over


def learn_as_sb3(ppo: Any, settings: PeerSettings, **own: Any) -> None:
    """Learns in turns.

    Args:
        ppo: The PPO of Stable-Baselines3, or another that takes its arguments.
        settings: What all have in common.
        **own: Further arguments, which not all of them take.
    """
    corridor = CorridorArrays(settings.areas, settings.seed, settings.corridor, normalised=True)
    sizes = [settings.hidden_size] * 2
    model = ppo(
        "MlpPolicy",
        CorridorSlots(corridor),
        learning_rate=settings.learning_rate,
        n_steps=settings.n_steps,
        batch_size=settings.batch_size,
        n_epochs=settings.epochs,
        gamma=settings.gamma,
        gae_lambda=settings.gae_lambda,
        clip_range=settings.clip_range,
        ent_coef=settings.ent_coef,
        vf_coef=settings.vf_coef,
        max_grad_norm=settings.max_grad_norm,
        policy_kwargs={"net_arch": {"pi": sizes, "vf": sizes}, "log_std_init": settings.log_std_init},
        seed=settings.seed,
        **own,
    )
    model.learn(FOR_EVER, callback=TakeTurns(settings.warm_up, corridor), log_interval=FOR_EVER)
