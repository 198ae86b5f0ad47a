"""What can wait until the next actions are on their way: done while the player moves."""

from collections.abc import Callable
from typing import Any

from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn


class Deferring(VecEnvWrapper):
    """The topmost stage: does what was deferred as soon as the next actions are sent."""

    def __init__(self, venv: VecEnv) -> None:
        super().__init__(venv)
        self._deferred: list[Callable[[], None]] = []

    def defer(self, work: Callable[[], None]) -> None:
        """Has something done during the next step, or instead of it if the actions can't be sent."""
        self._deferred.append(work)

    def reset(self) -> VecEnvObs:
        """Resets the environments."""
        return self.venv.reset()

    def step_async(self, actions: NDArray[Any]) -> None:
        """Passes the actions on, and does what was deferred."""
        try:
            self.venv.step_async(actions)
        finally:
            while self._deferred:
                self._deferred.pop()()

    def step_wait(self) -> VecEnvStepReturn:
        """Passes on what the environments answer."""
        return self.venv.step_wait()
