"""The players of a run as one ``VecEnv``: stepped concurrently, and started again when they die.

Crash handling is that of ``mlagents-learn``: the same failures, limits and defaults, each limit counted for each player
alone. What differs: only the player that failed starts again, and its seed moves on, so that it does not play the
episodes of its first life once more.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from mlagents_envs.base_env import BehaviorSpec
from mlagents_envs.exception import UnityException
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from trainer.config import RestartLimits
from trainer.errors import TrainerError
from trainer.players.area_state import PlayerState, said_states
from trainer.players.connected import open_all
from trainer.players.environment import Environment
from trainer.players.failures import FAILURES, BadNumbers, PlayerLogs, explain
from trainer.players.restarts import Restarts
from trainer.players.slots import Slots


@dataclass(frozen=True)
class OpenPlayer:
    """One player, open: its environment, its areas as slots, what they are doing, and its one behavior."""

    environment: Environment
    slots: VecEnv
    state: PlayerState
    behavior: str
    spec: BehaviorSpec


class Players(Slots):
    """Players of one kind, whose areas are slots: player k has the slots from ``k * areas`` on.

    All get their actions before the first answer is awaited. A player that dies or hangs is started again, and its
    running episodes are dropped: each of its slots shows an episode that is cut (``TimeLimit.truncated``, reward 0,
    the last observation that was seen as ``terminal_observation``), marked ``dropped`` in its info, and the first
    observation of the next.

    Args:
        start: Opens player k for its n-th life.
        lives: For each player, how often one was started before, in earlier parts of a resumed run.
        limits: How often one may be started again.
        logs: Where they log; one that died leaves its log as ``Player-<k>.died-<r>.log``.
        launched: Whether ``start`` launches players; else it waits for one to dial in, and waits only once.

    Attributes:
        behavior: The name of the players' behavior.
        behavior_spec: What its agents observe and do.
        areas: How many agents each player has: one per training area, if its areas have one each.
        observations: What every slot showed last, (slots, observation size).

    Raises:
        TrainerError: A player can't be opened, or one differs from the others.
    """

    def __init__(
        self,
        start: Callable[[int, int], OpenPlayer],
        lives: Sequence[int],
        limits: RestartLimits,
        logs: PlayerLogs,
        launched: bool,
    ) -> None:
        self._start = start
        self._earlier_lives = lives
        self._logs = logs
        self._launched = launched
        self._restarts = [Restarts(number, limits, logs, launched) for number in range(len(lives))]
        self._former_exchange_seconds = 0.0  # of players that died
        self._players = open_all(start, lives)
        first = self._players[0]
        self.behavior, self.behavior_spec, self.areas = first.behavior, first.spec, first.slots.num_envs
        try:
            for number, player in enumerate(self._players):
                self._check_alike(number, player)
        except TrainerError:
            self.close()
            raise
        super().__init__(len(lives) * self.areas, first.slots.observation_space, first.slots.action_space)

    @property
    def restarts(self) -> int:
        """How often players were started again."""
        return sum(each.count for each in self._restarts)

    @property
    def exchange_seconds(self) -> float:
        """Time spent exchanging messages with them, as ``Environment`` counts it."""
        return self._former_exchange_seconds + sum(each.environment.exchange_seconds for each in self._players)

    def ask_states(self) -> None:
        """Has every player that can send its areas' state with its answer to the next step."""
        for player in self._players:
            player.state.ask()

    def state_dict(self) -> dict[str, Any]:
        """Where a run's players are.

        Returns:
            ``lives``, how often each was started before the present one, in the whole run; ``observations``, what
            every slot showed last; and, if all have answered to ``ask_states``, ``state_<number>`` of each, bytes.
        """
        states = said_states([player.state for player in self._players])
        lives = [earlier + each.count for earlier, each in zip(self._earlier_lives, self._restarts, strict=True)]
        return {"lives": lives, "observations": self.observations, **states}

    def continues(self, state: Mapping[str, Any]) -> bool:
        """Whether the episodes of a saved run go on, now that the players were opened with its states.

        Args:
            state: What ``state_dict`` gave when it was saved.
        """
        if any(f"state_{number}" not in state for number in range(len(self._players))):
            return False
        is_same = np.array_equal(np.asarray(self.reset()), state["observations"])  # else one that ignores the channel
        return is_same and not any(player.state.is_refused for player in self._players)

    def reset(self) -> VecEnvObs:
        """Begins an episode in every slot."""
        parts = [self._reset(number) for number in range(len(self._players))]
        self.observations = parts[0] if len(parts) == 1 else np.concatenate(parts)
        self.reset_infos = [{} for _ in range(self.num_envs)]
        return self.observations

    def step_async(self, actions: NDArray[Any]) -> None:
        """Hands every player its actions."""
        for number, player in enumerate(self._players):
            player.slots.step_async(actions[self._slots(number)])

    def step_wait(self) -> VecEnvStepReturn:
        """Waits for every player's areas to ask for their next decision."""
        parts = [self._wait(number) for number in range(len(self._players))]
        if len(parts) == 1:
            self.observations = np.asarray(parts[0][0])
            return parts[0]
        observations, rewards, dones, infos = zip(*parts, strict=True)
        self.observations = np.concatenate(observations)
        return self.observations, np.concatenate(rewards), np.concatenate(dones), [i for part in infos for i in part]

    def close(self) -> None:
        """Closes every player."""
        for player in self._players:
            if player.environment.is_open:
                player.environment.close()

    def _slots(self, number: int) -> slice:
        return slice(number * self.areas, (number + 1) * self.areas)

    def _reset(self, number: int) -> NDArray[Any]:
        while True:
            try:
                return np.asarray(self._players[number].slots.reset())
            except FAILURES as error:
                self._restart(number, error)
            except BadNumbers as error:
                raise TrainerError(explain(error) + self._logs.hint(self._logs.of(number))) from error

    def _wait(self, number: int) -> VecEnvStepReturn:
        try:
            return self._players[number].slots.step_wait()
        except FAILURES as error:
            self._restart(number, error)
        except BadNumbers as error:
            where = error.in_area(0) if self.areas == 1 else error
            raise TrainerError(explain(where) + self._logs.hint(self._logs.of(number))) from where
        last, next_observations = self.observations[self._slots(number)], self._reset(number)
        cut = [{"terminal_observation": each, "TimeLimit.truncated": True, "dropped": True} for each in last]
        return next_observations, np.zeros(len(last), np.float32), np.ones(len(last), np.bool_), cut

    def _restart(self, number: int, failure: UnityException) -> None:
        """Replaces a player that died.

        Raises:
            TrainerError: It failed too often, it can't be started, or it is another one.
        """
        dead, restarts = self._players[number].environment, self._restarts[number]
        self._former_exchange_seconds += dead.exchange_seconds
        dead.kill()

        def start() -> OpenPlayer:
            return self._start(number, self._earlier_lives[number] + restarts.count)

        self._players[number] = player = restarts.start_again(failure, start)
        self._check_alike(number, player)

    def _check_alike(self, number: int, player: OpenPlayer) -> None:
        same = player.behavior == self.behavior and player.spec.action_spec == self.behavior_spec.action_spec
        shapes = [[tuple(each.shape) for each in spec.observation_specs] for spec in (player.spec, self.behavior_spec)]
        if not same or shapes[0] != shapes[1] or player.slots.num_envs != self.areas:
            raise TrainerError(
                f"Player {number} has {player.slots.num_envs} areas of {player.behavior} with observations of shapes "
                f"{shapes[0]}, but the first had {self.areas} of {self.behavior} with {shapes[1]}; all players have "
                "to be the same build."
            )
