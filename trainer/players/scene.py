"""The players of a run with every behavior of theirs: agents come, go, and ask for decisions when they like."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from mlagents_envs.base_env import ActionTuple, BehaviorSpec, DecisionSteps, TerminalSteps

from corridor_server.protocol.agents import ActionBatch, Agents, Behavior
from trainer.config import RestartLimits
from trainer.errors import TrainerError
from trainer.players.area_state import said_states
from trainer.players.behavior import described
from trainer.players.connected import Connected, open_all
from trainer.players.failures import FAILURES, BadNumbers, PlayerLogs, explain
from trainer.players.restarts import Restarts
from trainer.players.settings import set_parameters

Actions = Mapping[str, ActionBatch]


class Message(NamedTuple):
    """What one player said: by the full names of behaviors that have such agents.

    Attributes:
        ended: Agents whose episode ended.
        asking: Agents that ask for a decision.
        anew: Whether the player has begun new episodes everywhere: of none that ran before it will say the end.
    """

    ended: Mapping[str, Agents]
    asking: Mapping[str, Agents]
    anew: bool = False


class Scene:
    """Players of one kind. One that dies or hangs is started again; the episodes that it was in are dropped.

    Args:
        start: Opens player k for its n-th life.
        lives: For each player, how often one was started before, in earlier parts of a resumed run.
        limits: How often one may be started again.
        logs: Where they log.
        launched: Whether ``start`` launches players; else it waits for one to dial in.

    Attributes:
        behaviors: What is known so far, by full names such as ``Corridor?team=0``; some come late.

    Raises:
        TrainerError: A player can't be opened.
    """

    def __init__(
        self,
        start: Callable[[int, int], Connected],
        lives: Sequence[int],
        limits: RestartLimits,
        logs: PlayerLogs,
        launched: bool,
    ) -> None:
        self._start = start
        self._earlier_lives = lives
        self._logs = logs
        self._restarts = [Restarts(number, limits, logs, launched) for number in range(len(lives))]
        self._former_exchange_seconds = 0.0  # of players that died
        self._fresh = [True] * len(lives)  # whose first reset was made by whoever opened it
        self.behaviors: dict[str, Behavior] = {}
        self._known: dict[tuple[int, str], BehaviorSpec] = {}  # by player, those that were looked at
        self._players = open_all(start, lives)

    def __len__(self) -> int:
        return len(self._players)

    @property
    def restarts(self) -> int:
        """How often players were started again."""
        return sum(each.count for each in self._restarts)

    @property
    def exchange_seconds(self) -> float:
        """Time spent exchanging messages with them, as ``Environment`` counts it."""
        return self._former_exchange_seconds + sum(each.environment.exchange_seconds for each in self._players)

    def reset(self) -> list[Message]:
        """Begins episodes everywhere; what each player says then."""
        return [self._reset(number) for number in range(len(self._players))]

    def send(self, actions: Sequence[Actions]) -> None:
        """Hands every player the actions of its agents that asked, and waits for none.

        Args:
            actions: For each player, by full behavior names.
        """
        for number, chosen in enumerate(actions):
            self.send_one(number, chosen)

    def send_one(self, number: int, actions: Actions) -> None:
        """Hands one player the actions of its agents that asked, by full behavior names."""
        player = self._players[number]
        for name, batch in actions.items():
            if len(batch.continuous):
                player.environment.set_actions(name, ActionTuple(batch.continuous, batch.discrete))
        player.state.state = None  # what it answers is of its next message
        player.environment.send()

    def receive(self) -> list[Message]:
        """Waits for what every player says next."""
        return [self.receive_one(number) for number in range(len(self._players))]

    def receive_one(self, number: int) -> Message:
        """Waits for what one player says next."""
        try:
            self._players[number].environment.receive()
            return self._message(number)
        except FAILURES as error:
            self._restart(number, error)
        except BadNumbers as error:
            raise TrainerError(explain(error) + self._logs.hint(self._logs.of(number))) from error
        return self._reset(number)

    @property
    def says_its_state(self) -> bool:
        """Whether every player has shown that it can write down what its areas are doing."""
        return all(player.state.is_known for player in self._players)

    @property
    def took_up_its_state(self) -> bool:
        """Whether no player has said that it can't go on from the state that it was opened with."""
        return not any(player.state.is_refused for player in self._players)

    def set_parameters(self, values: Mapping[str, Any]) -> None:
        """Has every player set environment parameters; whoever opens one that takes a dead one's place, sets its own.

        Args:
            values: Numbers or samplers by name, as ``mlagents-learn``'s YAML has them.
        """
        for player in self._players:
            set_parameters(player.parameters, values, player.seed)

    def statistics(self) -> dict[str, list[float]]:
        """What the players have reported since this was last asked, by name."""
        found: dict[str, list[float]] = {}
        for player in self._players:
            for name, values in player.statistics.get_and_reset_stats().items():
                found.setdefault(name, []).extend(value for value, _ in values if np.isfinite(value))
        return found

    def ask_states(self) -> None:
        """Has every player that can send its areas' state with its next message."""
        for player in self._players:
            player.state.ask()

    def state_dict(self) -> dict[str, Any]:
        """``lives``, how often each was started before, and if all have said it, ``state_<number>`` of each, bytes."""
        states = said_states([player.state for player in self._players])
        lives = [earlier + each.count for earlier, each in zip(self._earlier_lives, self._restarts, strict=True)]
        return {"lives": lives, **states}

    def close(self) -> None:
        """Closes every player."""
        for player in self._players:
            if player.environment.is_open:
                player.environment.close()

    def _reset(self, number: int) -> Message:
        while True:
            try:
                if not self._fresh[number]:
                    self._players[number].environment.reset()
                self._fresh[number] = False
                return self._message(number)._replace(anew=True)
            except FAILURES as error:
                self._restart(number, error)
            except BadNumbers as error:
                raise TrainerError(explain(error) + self._logs.hint(self._logs.of(number))) from error

    def _message(self, number: int) -> Message:
        environment = self._players[number].environment
        ended, asking = {}, {}
        for name, spec in environment.behavior_specs.items():
            if self._known.get((number, name)) is not spec:
                self._check_same(number, described(name, spec))
                self._known[number, name] = spec
            decision, terminal = environment.get_steps(name)
            if len(terminal):
                ended[name] = _agents(terminal)
            if len(decision):
                asking[name] = _agents(decision)
                _check_masks(name, asking[name])
        return Message(ended, asking)

    def _check_same(self, number: int, found: Behavior) -> None:
        """Takes a behavior in.

        Raises:
            TrainerError: It is another one than the player that had it first says.
        """
        known = self.behaviors.setdefault(found.name, found)
        if found != known:
            shapes = [[each.shape for each in one.sensors] for one in (found, known)]
            raise TrainerError(
                f"Player {number} has behavior {found.name} with observations of shapes {shapes[0]} and actions "
                f"({found.continuous_actions}, {found.discrete_branches}), but shapes {shapes[1]} and actions "
                f"({known.continuous_actions}, {known.discrete_branches}) were known; all players have to be the same "
                "build."
            )

    def _restart(self, number: int, failure: Any) -> None:
        """Replaces a player that died.

        Raises:
            TrainerError: It failed too often, or it can't be started.
        """
        dead, restarts = self._players[number].environment, self._restarts[number]
        self._former_exchange_seconds += dead.exchange_seconds
        dead.kill()

        def start() -> Connected:
            return self._start(number, self._earlier_lives[number] + restarts.count)

        self._players[number] = restarts.start_again(failure, start)
        self._fresh[number] = True


def _agents(steps: DecisionSteps | TerminalSteps) -> Agents:
    count, terminal = len(steps), isinstance(steps, TerminalSteps)
    interrupted = np.asarray(steps.interrupted, np.bool_) if terminal else np.zeros(count, np.bool_)
    masks = () if terminal else tuple(steps.action_mask or ())
    return Agents(
        steps.agent_id,
        steps.reward,
        np.full(count, terminal),
        interrupted,
        tuple(steps.obs),
        np.asarray(steps.group_id, np.int32),
        np.asarray(steps.group_reward, np.float32),
        masks,
    )


def _check_masks(name: str, agents: Agents) -> None:
    """Refuses a mask that leaves no choice.

    Raises:
        TrainerError: There is one.
    """
    for branch, mask in enumerate(agents.masks):
        nothing = mask.all(axis=1)
        if nothing.any():
            agent = int(agents.ids[nothing.argmax()])
            raise TrainerError(
                f"Agent {agent} of {name} masks all {mask.shape[1]} choices of discrete branch {branch}, but one that "
                "may be taken was expected; look at WriteDiscreteActionMask in the scene."
            )
