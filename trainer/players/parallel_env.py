"""``UnityParallelEnv``: an ML-Agents environment as a ``pettingzoo.ParallelEnv``, with all its behaviors and agents."""

import copy
import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from mlagents_envs.base_env import ActionTuple, BaseEnv, BehaviorSpec, DecisionSteps, TerminalSteps
from numpy.typing import NDArray

from corridor_server.shared.given import shown
from corridor_server.shared.patience import MESSAGES_WITHOUT_DECISION
from trainer.errors import TrainerError
from trainer.players.behavior_spaces import (
    Observation,
    ObservationLayout,
    action_arrays,
    action_mask,
    action_space,
    all_rewards,
    allowed_choices,
)
from trainer.players.owned import CLOSED, closed_if_refused, compressed_pictures

try:
    from pettingzoo import ParallelEnv
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError(
        f"UnityParallelEnv needs {missing.name}, which is not installed: "
        "pip install 'curious-corridor[client,pettingzoo]'",
        name=missing.name,
    ) from missing


class _Key(NamedTuple):
    """An agent as the player has it."""

    behavior: str
    number: int


@dataclass
class _Seen:
    """What a live agent showed last, and what came of it since the last step."""

    observation: Observation
    allowed: NDArray[np.bool_]
    reward: float = 0.0
    terminated: bool = False
    truncated: bool = False


@dataclass
class _Kind:
    """What the agents of one behavior have in common."""

    spec: BehaviorSpec
    layout: ObservationLayout

    def rows(self, steps: DecisionSteps | TerminalSteps) -> Iterator[tuple[int, int, Observation, float]]:
        """Row, agent id, observation and reward of each agent."""
        parts, rewards = self.layout.parts(steps), all_rewards(steps)
        for row, number in enumerate(steps.agent_id.tolist()):
            yield row, number, self.layout.value([part[row] for part in parts]), float(rewards[row])


@dataclass
class _Episode:
    """What is known since the last reset.

    Attributes:
        live: What each live agent showed last.
        names: Of all that live or lived.
        over: Who is ignored: agents that ended, and their successors.
        vacant: Of those, who asks no more, until they or successors do.
        asking: Who asked in the last message, and what it may choose.
    """

    live: dict[_Key, _Seen] = field(default_factory=dict)
    names: dict[_Key, str] = field(default_factory=dict)
    over: set[_Key] = field(default_factory=set)
    vacant: list[_Key] = field(default_factory=list)
    asking: dict[_Key, NDArray[np.bool_]] = field(default_factory=dict)

    def end(self, key: _Key, observation: Observation, reward: float, interrupted: bool) -> None:
        """Takes note of an agent's end; of one that ended before it ever asked, ML-Agents makes no episode."""
        seen = self.live.pop(key, None)
        if seen is not None:
            seen.observation, seen.truncated, seen.terminated = observation, interrupted, not interrupted
            seen.reward += reward
            self.over.add(key)
        if key in self.over:
            self.vacant.append(key)

    def is_successor(self, key: _Key) -> bool:
        """Whether an agent that is not known takes the place of one that ended; it is known then."""
        place = next((each for each in self.vacant if each.behavior == key.behavior), None)
        if place is None:
            return False
        self.vacant.remove(place)
        self.over.add(key)
        return True


class UnityParallelEnv(ParallelEnv):  # type: ignore[misc]  # pettingzoo has no type information
    """All agents of all behaviors, named ``<behavior without its team>_<n>``.

    ``reset`` begins an episode with the agents that ask first. An agent whose episode ends leaves ``agents`` until the
    next reset, although the player may begin another for it: what it does there is ignored, as is an agent of a new id
    that takes an ended one's place. Any other agent that comes joins ``agents``; ``possible_agents`` grows with them.

    ``step`` runs until every live agent has asked for a decision again, or ended. Agents may ask unevenly: one that
    asks more often than others meanwhile takes its action again, and its rewards add up; one that asks less often takes
    its action when it asks. Where a mask has come to forbid such an action, the first allowed choice stands in for it.
    A step ends early when an agent comes, so that its first action is chosen for it; the others then show what they
    showed.

    Vector observations alone are one Box, one after another; any others a Dict of all, ``obs_0``, ``obs_1``, ..., all
    float32, pictures (height, width, channels), compressed ones from 0 to 1. Actions are a Box, Discrete,
    MultiDiscrete, or, of both kinds, Tuple((Box, MultiDiscrete)); with discrete ones, an agent's info has
    ``action_mask``, int8, 1 for what is allowed, as its action space's ``sample`` takes it. A reward is the agent's own
    with its group's added. An interrupted episode is truncated, every other end is terminated; none is both.

    Args:
        environment: The environment; closing this closes it, and so does a refusal of it.

    Raises:
        TrainerError: A behavior observes or does nothing.
    """

    metadata = {"name": "UnityParallelEnv", "render_modes": []}  # noqa: RUF012 - PettingZoo's
    render_mode = None

    def __init__(self, environment: BaseEnv) -> None:
        self._environment = environment
        self._closed = False
        self._kinds: dict[str, _Kind] = {}
        self._former: dict[_Key, str] = {}  # names in the episode before
        self._behaviors: dict[str, str] = {}  # of every name
        self._spaces: dict[str, tuple[spaces.Space[Any], spaces.Space[Any]]] = {}
        self._episode = _Episode()
        with closed_if_refused(environment):
            self._begin()
        self._fresh = True  # an episode that the first reset() gives out

    @property
    def agents(self) -> list[str]:
        """Those that live."""
        return [self._episode.names[key] for key in self._episode.live]

    @property
    def possible_agents(self) -> list[str]:
        """All that ever lived."""
        return list(self._spaces)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """What an agent observes."""
        return self._spaces[agent][0]

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """What an agent does."""
        return self._spaces[agent][1]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Begins an episode; ``seed`` and ``options`` reach nobody: a player takes its seed when it is opened.

        Raises:
            TrainerError: The environment is closed.
        """
        self._check_open()
        if not self._fresh:
            self._begin()
        self._fresh = False
        live = {self._episode.names[key]: seen for key, seen in self._episode.live.items()}
        return {agent: seen.observation for agent, seen in live.items()}, self._infos(live)

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]]:
        """Gives every live agent its action.

        Args:
            actions: Of each of ``agents``.

        Returns:
            Observations, rewards, terminations, truncations and infos of who lived before the step, or came in it.

        Raises:
            TrainerError: A live agent has no action, or none of its space; an agent neither asks again nor ends; or the
                environment is closed.
        """
        self._check_open()
        if not isinstance(actions, Mapping):
            raise TrainerError(
                f"The actions are {shown(actions)}, but a dict of one for {', '.join(self.agents)} each was expected."
            )
        self._fresh = False
        episode = self._episode
        chosen = {key: self._arrays(key, actions) for key in episode.live}
        for seen in episode.live.values():
            seen.reward = 0.0
        involved, waiting, messages = dict(episode.live), set(episode.live), 0
        while waiting:
            self._answer(chosen, as_they_are=messages == 0)
            self._environment.step()
            messages += 1
            came = self._take()
            involved |= {key: episode.live[key] for key in came}
            waiting = {key for key in waiting if key in episode.live and key not in episode.asking}
            if came:
                break
            if messages == MESSAGES_WITHOUT_DECISION:
                silent = ", ".join(self._episode.names[key] for key in waiting)
                raise TrainerError(
                    f"Of the agents, {silent} neither asked for a decision nor ended in {messages} messages of the "
                    "player; look for agents that are disabled, or without a DecisionRequester."
                )
        named = {self._episode.names[key]: seen for key, seen in involved.items()}
        return (
            {agent: seen.observation for agent, seen in named.items()},
            {agent: seen.reward for agent, seen in named.items()},
            {agent: seen.terminated for agent, seen in named.items()},
            {agent: seen.truncated for agent, seen in named.items()},
            self._infos(named),
        )

    def render(self) -> None:
        """Draws nothing."""

    def close(self) -> None:
        """Closes the environment; a second time has no effect."""
        if not self._closed:
            self._closed = True
            self._environment.close()

    def _check_open(self) -> None:
        if self._closed:
            raise TrainerError(CLOSED)

    def _infos(self, seen: Mapping[str, _Seen]) -> dict[str, dict[str, Any]]:
        """The masks of those that live on, where there are any: who ended chooses no more."""
        infos: dict[str, dict[str, Any]] = {agent: {} for agent in seen}
        for agent, each in seen.items():
            if len(each.allowed) and not (each.terminated or each.truncated):
                spec = self._kinds[self._behaviors[agent]].spec.action_spec
                infos[agent]["action_mask"] = action_mask(spec, each.allowed)
        return infos

    def _begin(self) -> None:
        self._environment.reset()
        self._former, self._episode = self._episode.names, _Episode()
        while not self._take():  # Unity may have messages before, without any agent that asks
            self._environment.step()

    def _take(self) -> list[_Key]:
        """Takes the player's message up; returns who came with it."""
        episode, found = self._episode, []
        episode.asking = {}
        for behavior, spec in self._environment.behavior_specs.items():
            if behavior not in self._kinds:
                pictures = compressed_pictures(self._environment, behavior)
                self._kinds[behavior] = _Kind(spec, ObservationLayout(spec, pictures))
            decision, terminal = self._environment.get_steps(behavior)
            for row, number, observation, reward in self._kinds[behavior].rows(terminal):
                episode.end(_Key(behavior, number), observation, reward, bool(terminal.interrupted[row]))
            allowed = allowed_choices(spec.action_spec, decision)
            for row, number, observation, reward in self._kinds[behavior].rows(decision):
                key = _Key(behavior, number)
                episode.asking[key] = allowed[row]
                if key in episode.live:
                    seen = episode.live[key]
                    seen.observation, seen.allowed, seen.reward = observation, allowed[row], seen.reward + reward
                elif key in episode.vacant:
                    episode.vacant.remove(key)
                elif key not in episode.over:
                    found.append((key, _Seen(observation, allowed[row])))
        came = {key: seen for key, seen in found if not episode.is_successor(key)}
        episode.live |= came
        for key in sorted(came, key=lambda key: key not in self._former):
            episode.names[key] = self._name(key)
        return list(came)

    def _name(self, key: _Key) -> str:
        """The agent's name in the episode before, or the first that is free."""
        used, base = set(self._episode.names.values()), key.behavior.partition("?")[0]
        former = [self._former[key]] if key in self._former else []
        for name in itertools.chain(former, (f"{base}_{number}" for number in itertools.count())):
            if name not in used and self._behaviors.setdefault(name, key.behavior) == key.behavior:
                break
        if name not in self._spaces:
            kind = self._kinds[key.behavior]
            self._spaces[name] = (copy.deepcopy(kind.layout.space), action_space(kind.spec.action_spec))
        return name

    def _arrays(self, key: _Key, actions: Mapping[str, Any]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """An agent's action, in one row."""
        name = self._episode.names[key]
        if actions.get(name) is None:
            raise TrainerError(
                f"Agent {name} has no action, but one for each of {', '.join(self.agents)} was expected."
            )
        try:
            numbers, choices = action_arrays(self._kinds[key.behavior].spec.action_spec, actions[name], 1)
        except TrainerError as error:
            raise TrainerError(f"Agent {name}: {error}") from error
        if not np.isfinite(numbers).all():
            raise TrainerError(f"The action of {name} is {actions[name]}, but finite numbers were expected.")
        return numbers, choices

    def _answer(self, chosen: Mapping[_Key, tuple[NDArray[np.float32], NDArray[np.int32]]], as_they_are: bool) -> None:
        """Sends every agent that asked an action: zeros to who is ignored.

        Args:
            chosen: Live agents' actions.
            as_they_are: Whether a forbidden choice is sent, too: its agent was shown the mask.
        """
        for behavior, kind in self._kinds.items():
            rows = []
            for key, allowed in self._episode.asking.items():
                if key.behavior != behavior:
                    continue
                spec, is_chosen = kind.spec.action_spec, key in chosen and key in self._episode.live
                empty = spec.empty_action(1)
                numbers, choices = chosen[key] if is_chosen else (empty.continuous, empty.discrete)
                if not (as_they_are and is_chosen):
                    choices = _permitted(choices, allowed, spec.discrete_branches)
                rows.append((numbers, choices))
            if rows:
                self._environment.set_actions(behavior, ActionTuple(*map(np.concatenate, zip(*rows, strict=True))))


def _permitted(choices: NDArray[np.int32], allowed: NDArray[np.bool_], branches: tuple[int, ...]) -> NDArray[np.int32]:
    """An agent's choices (1, branches), each that is forbidden replaced by its branch's first allowed one."""
    masks = np.split(allowed, np.cumsum(branches)[:-1]) if branches else []
    kept = [choice if mask[choice] else np.argmax(mask) for choice, mask in zip(choices[0], masks, strict=True)]
    return np.array([kept], np.int32)
