"""When ends and requests are sent: in one message, or in two as Unity does, where agents act once after a reset."""

import gymnasium
import numpy as np
import pytest
from mlagents_envs.base_env import ActionTuple
from numpy.typing import NDArray

from corridor_server.corridor.areas import Areas
from corridor_server.corridor.corridor_config import CorridorConfig
from corridor_server.decision_timing import Apart, Together
from corridor_server.protocol import side_channels
from corridor_server.protocol.agents import Agents

BEHAVIOR = "Corridor?team=0"
IDLE = np.zeros((3, 2), np.float32)
NOBODY = IDLE[:0]


def areas(seed: int = 0, **config: float) -> Areas:
    return Areas(CorridorConfig(**config), seed, range(3))  # type: ignore[arg-type]


def equal(one: Agents, other: Agents) -> bool:
    columns = ("ids", "rewards", "done", "interrupted", "observations")
    return all(np.array_equal(getattr(one, name), getattr(other, name)) for name in columns)


def test_together_says_what_the_simulation_says():
    timing, simulation = Together(areas(max_episode_steps=2)), areas(max_episode_steps=2)
    assert equal(timing.reset()[0], simulation.reset())
    for _ in range(5):
        (agents, statistics), (expected, of_episodes) = timing.step(IDLE), simulation.step(IDLE)
        assert equal(agents, expected)
        assert statistics.keys() == of_episodes.keys()


def test_after_a_reset_every_agent_has_acted_once_and_its_request_has_that_steps_reward():
    timing, simulation = Apart(areas()), areas()
    for _ in range(3):
        simulation.reset()
        expected, _ = simulation.step(IDLE)
        agents, statistics = timing.reset()
        assert equal(agents, expected)
        assert (agents.rewards != 0).all()
        assert statistics == {}


def test_an_end_comes_alone_with_its_statistics_and_all_ask_in_the_next_message_with_the_same_ids():
    simulation, other = areas(max_episode_steps=9), areas(max_episode_steps=9)
    timing = Apart(simulation)
    timing.reset()
    other.reset()
    other.step(IDLE)
    timing.step(IDLE)
    other.step(IDLE)
    for each in (simulation, other):
        each.state.episode_steps[1] = 8
    together, of_episodes = other.step(IDLE)
    ended, statistics = timing.step(IDLE)
    assert ended.ids.tolist() == [1]
    assert equal(ended, together.ended)
    assert statistics == of_episodes
    asking, statistics = timing.step(NOBODY)
    assert asking.ids.tolist() == [0, 1, 2]
    assert equal(asking, together.deciding)
    assert asking.rewards[1] == 0.0
    assert statistics == {}
    assert equal(timing.step(IDLE)[0], other.step(IDLE)[0]), "the message between moves nothing"


def test_a_reset_drops_the_requests_that_were_due():
    timing, simulation = Apart(areas(max_episode_steps=2)), areas(max_episode_steps=2)
    timing.reset()
    assert timing.step(IDLE)[0].done.all()
    simulation.reset()
    simulation.step(IDLE)
    simulation.step(IDLE)
    simulation.reset()
    expected, _ = simulation.step(IDLE)
    assert equal(timing.reset()[0], expected), "the episode that has begun is acted in, not skipped"
    assert timing.step(IDLE)[0].done.all()


def test_an_episode_that_ends_in_the_step_after_a_reset_is_an_end_of_agents_that_never_asked():
    timing = Apart(areas(max_episode_steps=1))
    ended, statistics = timing.reset()
    assert ended.done.tolist() == [True] * 3
    assert list(statistics["Corridor/Episode Length"]) == [1, 1, 1]
    assert timing.step(NOBODY)[0].done.tolist() == [False] * 3


def test_a_saved_state_that_was_put_back_is_shown_as_it_was():
    saved = areas(max_episode_steps=9)
    before = Apart(saved)
    before.reset()
    for _ in range(5):
        last, _ = before.step(IDLE)
    [(_, payload)] = side_channels.split(side_channels.write_state(saved.snapshot()))
    restored = areas(seed=5, max_episode_steps=9)
    restored.restore(side_channels.read_state(payload, restored.snapshot()))
    after = Apart(restored)
    for _ in range(2):  # a second RESET keeps what has not moved, too
        assert np.array_equal(after.reset()[0].observations, last.observations)
    for _ in range(12):
        agents, _ = before.step(IDLE)
        assert equal(after.step(IDLE)[0], agents)
    assert (after.reset()[0].rewards != 0).all(), "once it has moved, a reset is one as any other"


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
