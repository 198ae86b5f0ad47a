"""When ends and requests are sent: in one message, or in two as Unity does, where agents act once after a reset."""

from collections.abc import Mapping

import gymnasium
import numpy as np
import pytest
from mlagents_envs.base_env import ActionTuple
from numpy.typing import NDArray
from only_behavior import BEHAVIOR, act, acting, begin, only

from corridor_server.corridor.areas import Areas
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.decision_timing import Apart, Timing, Together
from corridor_server.protocol import side_channels
from corridor_server.protocol.agents import ActionBatch, Agents, Behavior, Sensor
from corridor_server.simulations.simulation import Simulation, Statistics

IDLE = np.zeros((3, 2), np.float32)
NOBODY = IDLE[:0]


def areas(seed: int = 0, **config: float) -> Areas:
    return Areas(CorridorConfig(**config), seed, range(3))  # type: ignore[arg-type]


def restart(timing: Timing) -> tuple[Agents, Statistics]:
    moment, statistics = timing.reset()
    return only(moment), statistics


def answer(timing: Timing, actions: NDArray[np.float32]) -> tuple[Agents, Statistics]:
    moment, statistics = timing.step(acting(actions) if len(actions) else {})
    return only(moment), statistics


def equal(one: Agents, other: Agents) -> bool:
    columns = ("ids", "rewards", "done", "interrupted")
    seen = np.array_equal(one.observations[0], other.observations[0])
    return seen and all(np.array_equal(getattr(one, name), getattr(other, name)) for name in columns)


def test_together_says_what_the_simulation_says():
    timing, simulation = Together(areas(max_episode_steps=2)), areas(max_episode_steps=2)
    assert equal(restart(timing)[0], begin(simulation))
    for _ in range(5):
        (agents, statistics), (expected, of_episodes) = answer(timing, IDLE), act(simulation, IDLE)
        assert equal(agents, expected)
        assert statistics.keys() == of_episodes.keys()


def test_after_a_reset_every_agent_has_acted_once_and_its_request_has_that_steps_reward():
    timing, simulation = Apart(areas()), areas()
    for _ in range(3):
        begin(simulation)
        expected, _ = act(simulation, IDLE)
        agents, statistics = restart(timing)
        assert equal(agents, expected)
        assert (agents.rewards != 0).all()
        assert statistics == {}


def test_an_end_comes_alone_with_its_statistics_and_all_ask_in_the_next_message_with_the_same_ids():
    simulation, other = areas(max_episode_steps=9), areas(max_episode_steps=9)
    timing = Apart(simulation)
    restart(timing)
    begin(other)
    act(other, IDLE)
    answer(timing, IDLE)
    act(other, IDLE)
    for each in (simulation, other):
        each.state.episode_steps[1] = 8
    together, of_episodes = act(other, IDLE)
    ended, statistics = answer(timing, IDLE)
    assert ended.ids.tolist() == [1]
    assert equal(ended, together.ended)
    assert statistics == of_episodes
    asking, statistics = answer(timing, NOBODY)
    assert asking.ids.tolist() == [0, 1, 2]
    assert equal(asking, together.deciding)
    assert asking.rewards[1] == 0.0
    assert statistics == {}
    assert equal(answer(timing, IDLE)[0], act(other, IDLE)[0]), "the message between moves nothing"


def test_a_reset_drops_the_requests_that_were_due():
    timing, simulation = Apart(areas(max_episode_steps=2)), areas(max_episode_steps=2)
    restart(timing)
    assert answer(timing, IDLE)[0].done.all()
    begin(simulation)
    act(simulation, IDLE)
    act(simulation, IDLE)
    begin(simulation)
    expected, _ = act(simulation, IDLE)
    assert equal(restart(timing)[0], expected), "the episode that has begun is acted in, not skipped"
    assert answer(timing, IDLE)[0].done.all()


def test_an_episode_that_ends_in_the_step_after_a_reset_is_an_end_of_agents_that_never_asked():
    timing = Apart(areas(max_episode_steps=1))
    ended, statistics = restart(timing)
    assert ended.done.tolist() == [True] * 3
    assert list(statistics["Corridor/Episode Length"]) == [1, 1, 1]
    assert answer(timing, NOBODY)[0].done.tolist() == [False] * 3


def test_a_saved_state_that_was_put_back_is_shown_as_it_was():
    saved = areas(max_episode_steps=9)
    before = Apart(saved)
    restart(before)
    for _ in range(5):
        last, _ = answer(before, IDLE)
    [(_, payload)] = side_channels.split(side_channels.write_state(saved.snapshot()))
    restored = areas(seed=5, max_episode_steps=9)
    restored.restore(side_channels.read_state(payload, restored.snapshot()))
    after = Apart(restored)
    for _ in range(2):  # a second RESET keeps what has not moved, too
        assert np.array_equal(restart(after)[0].observations[0], last.observations[0])
    for _ in range(12):
        agents, _ = answer(before, IDLE)
        assert equal(answer(after, IDLE)[0], agents)
    assert (restart(after)[0].rewards != 0).all(), "once it has moved, a reset is one as any other"


class Relay(Simulation):
    """Two behaviors, of numbers and of choices: each message's agents, and what they got, are as they were scripted."""

    behaviors: Mapping[str, Behavior] = {
        "Runner?team=0": Behavior("Runner?team=0", (Sensor.of("place", (1,)),), 2),
        "Chooser?team=1": Behavior("Chooser?team=1", (Sensor.of("place", (1,)),), 0, (3, 2)),
    }

    def __init__(self, *moments: dict[str, Agents]) -> None:
        self._moments = list(moments)
        self.got: list[Mapping[str, ActionBatch]] = []

    def reset(self) -> dict[str, Agents]:
        return self._moments.pop(0)

    def step(self, actions: Mapping[str, ActionBatch]) -> tuple[dict[str, Agents], Statistics]:
        self.got.append(actions)
        return self._moments.pop(0), {"steps": np.array([float(len(self.got))])}


def some(*ids: int, ended: int = 0) -> Agents:
    """Agents of which the first few ended."""
    count = len(ids)
    done, places = np.arange(count) < ended, np.array(ids, np.float32)[:, None]
    return Agents.ungrouped(np.array(ids, np.int32), np.ones(count, np.float32), done, np.zeros(count, bool), (places,))


def ids(moment: Mapping[str, Agents]) -> dict[str, list[int]]:
    """Of each behavior that has agents in a message."""
    return {name: agents.ids.tolist() for name, agents in moment.items() if len(agents)}


def test_an_end_in_one_behavior_holds_the_requests_of_every_behavior_back():
    runner, chooser = Relay.behaviors
    relay = Relay(
        {runner: some(0, 1), chooser: some(2)},
        {runner: some(0, 1), chooser: some(2)},
        {runner: some(1, 0, 1, ended=1), chooser: some(2)},
        {chooser: some(2)},
    )
    timing = Apart(relay)
    first, _ = timing.reset()
    assert ids(first) == {runner: [0, 1], chooser: [2]}
    actions = {name: ActionBatch.zeros(len(agents), relay.behaviors[name]) for name, agents in first.items()}
    ended, statistics = timing.step(actions)
    assert ids(ended) == {runner: [1]}
    assert statistics["steps"].tolist() == [2.0]
    requests, statistics = timing.step({})
    assert ids(requests) == {runner: [0, 1], chooser: [2]}
    assert not any(agents.done.any() for agents in requests.values())
    assert statistics == {}
    assert len(relay.got) == 2, "the message between moves nothing"
    assert ids(timing.step(actions)[0]) == {chooser: [2]}, "nobody else asks yet"


def test_after_a_reset_the_agents_of_every_behavior_act_once_with_0_or_the_first_choice():
    runner, chooser = Relay.behaviors
    relay = Relay({runner: some(0, 1), chooser: some(2)}, {runner: some(0)})
    assert ids(Apart(relay).reset()[0]) == {runner: [0]}
    [idle] = relay.got
    assert idle.keys() == {runner, chooser}
    assert idle[runner].continuous.tolist() == [[0.0, 0.0]] * 2
    assert idle[runner].discrete.shape == (2, 0)
    assert idle[chooser].continuous.shape == (1, 0)
    assert idle[chooser].discrete.tolist() == [[0, 0]]


def test_agents_that_dont_act_when_idle_are_asked_as_they_begin():
    """As those that take turns: a step for nobody would be somebody's turn."""
    runner, chooser = Relay.behaviors
    begun = {runner: some(0), chooser: some(2)}
    relay = Relay(begun)
    relay.acts_when_idle = False
    assert Apart(relay).reset() == (begun, {})
    assert relay.got == []


def test_together_passes_every_behaviors_agents_and_actions_on_as_they_are():
    runner, chooser = Relay.behaviors
    moments = {runner: some(0)}, {runner: some(0, 0, ended=1), chooser: some(2)}
    relay = Relay(*moments)
    timing = Together(relay)
    assert timing.reset() == (moments[0], {})
    actions = {runner: ActionBatch.zeros(1, relay.behaviors[runner])}
    assert timing.step(actions)[0] is moments[1]
    assert relay.got == [actions]


class InProcess:
    """The same areas in process, one by one."""

    def __init__(self, count: int, seed: int) -> None:
        self._envs = [gymnasium.make("corridor_server:Corridor-v0", area=area) for area in range(count)]
        self.observations = np.array([env.reset(seed=seed)[0] for env in self._envs])
        self._unmoved = np.ones(count, np.bool_)

    def reset(self) -> None:
        for area, env in enumerate(self._envs):
            if not self._unmoved[area]:
                self.observations[area] = env.reset()[0]
        self._unmoved[:] = True

    def step(self, actions: NDArray[np.float32]) -> tuple[NDArray[np.float32], dict[int, tuple]]:
        """Rewards of what goes on, and of each area whose episode ended (last observation, reward, truncated)."""
        rewards, ends = np.zeros(len(actions), np.float32), {}
        for area, env in enumerate(self._envs):
            observation, reward, terminated, truncated, _ = env.step(actions[area])
            if terminated or truncated:
                ends[area] = observation, np.float32(reward), truncated
                observation, reward = env.reset()[0], 0.0
            self.observations[area], rewards[area] = observation, reward
        self._unmoved[:] = [area in ends for area in range(len(actions))]
        return rewards, ends


@pytest.mark.slow
def test_unitys_timing_over_grpc_as_in_process_bit_for_bit(open_corridor):
    """10,000 random-action steps with resets between: observation, reward and end of each area, in float32."""
    count, steps, seed = 8, 1250, 1
    environment = open_corridor(seed=seed, num_areas=count, env_args=["--decision-timing", "unity"])
    oracle, rng = InProcess(count, seed), np.random.default_rng(0)
    reset_due, episodes, dropped = True, 0, 0
    for _ in range(steps):
        if reset_due:
            oracle.reset()
            environment.reset()
            actions = np.zeros((count, 2), np.float32)
        else:
            actions = rng.uniform(-1.1, 1.1, (count, 2)).astype(np.float32)
            environment.set_actions(BEHAVIOR, ActionTuple(continuous=actions))
            environment.step()
        rewards, ends = oracle.step(actions)
        reset_due = rng.random() < 0.002
        decision, terminal = environment.get_steps(BEHAVIOR)
        assert terminal.agent_id.tolist() == list(ends)
        for area, (observation, reward, truncated) in ends.items():
            assert np.array_equal(terminal[area].obs[0], observation)
            assert terminal[area].reward == reward
            assert bool(terminal[area].interrupted) == truncated
        if ends:
            episodes += len(ends)
            assert len(decision) == 0
            if reset_due := rng.random() < 0.2:
                dropped += 1
                continue
            environment.step()
            decision, terminal = environment.get_steps(BEHAVIOR)
            assert len(terminal) == 0
        assert decision.agent_id.tolist() == list(range(count))
        assert np.array_equal(decision.obs[0], oracle.observations)
        assert np.array_equal(decision.reward, rewards)
    assert episodes > 15
    assert dropped
