"""The collector's memory: every step of every agent is in it once, with what the agent saw, did and got."""

from dataclasses import dataclass, field

import numpy as np
import pytest
import torch
from gymnasium.spaces import Box
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3.common.buffers import RolloutBuffer

from corridor_server.protocol.agents import Agents, Behavior, Sensor
from trainer.learning.experience import Experience
from trainer.learning.transitions import Decided, Observed, advantages

BEHAVIOR = Behavior("Agent?team=0", (Sensor.of("number", (1,)),), continuous_actions=1)
NAME = BEHAVIOR.name


def agents(ids, seen, rewards, *, ended=False, interrupted=False, group=0.0):
    count = len(ids)
    return Agents(
        np.array(ids, np.int32),
        np.array(rewards, np.float32),
        np.full(count, ended),
        np.broadcast_to(interrupted, count),
        (np.array(seen, np.float32).reshape(count, 1),),
        np.zeros(count, np.int32),
        np.full(count, group, np.float32),
    )


def decided(actions):
    column = np.array(actions, np.float32).reshape(-1, 1)
    return Decided(column, np.zeros((len(column), 0), np.int64), column[:, 0])


@dataclass
class Teller:
    """Tells an experience what agents do, one message after another, and remembers what it should make of it.

    What an agent sees and does are numbers of which there is one each, so that none can be mixed up.
    """

    experience: Experience
    number: float = 0.0
    open: dict = field(default_factory=dict)  # (player, agent): seen, action
    expected: list = field(default_factory=list)
    taken: list = field(default_factory=list)

    def next(self, count):
        first = self.number
        self.number += count
        return [first + index for index in range(count)]

    def message(self, player, ended, asking):
        experience = self.experience
        if ended:
            seen, rewards = self.next(len(ended)), self.next(len(ended))
            for agent, last, reward in zip(ended, seen, rewards, strict=True):
                if (player, agent) in self.open:
                    self.expected.append((*self.open.pop((player, agent)), reward, last))
            batch = agents(ended, seen, rewards, ended=True)
            experience.end(player, NAME, batch, batch.observations)
        if asking:
            seen, rewards, actions = self.next(len(asking)), self.next(len(asking)), self.next(len(asking))
            for agent, now, reward, action in zip(asking, seen, rewards, actions, strict=True):
                if (player, agent) in self.open:
                    self.expected.append((*self.open[player, agent], reward, now))
                self.open[player, agent] = now, action
            batch = agents(asking, seen, rewards)
            asked = experience.ask(player, NAME, batch, Observed(batch.observations))
            return asked, decided(actions)
        return None

    def take(self, waiting=()):
        transitions, moved = self.experience.take(waiting)
        self.taken.extend(
            zip(
                transitions.observed[0][:, 0].tolist(),
                transitions.decided.continuous[:, 0].tolist(),
                transitions.rewards.tolist(),
                transitions.next_observed[0][:, 0].tolist(),
                strict=True,
            )
        )
        return moved


messages = st.lists(
    st.tuples(
        st.integers(0, 1),  # the player
        st.lists(st.integers(0, 6), unique=True, max_size=4),  # who ends
        st.lists(st.integers(0, 6), unique=True, max_size=5),  # who asks
        st.booleans(),  # whether there is an update between message and actions
    ),
    max_size=40,
)


@given(messages, st.integers(1, 5))
@settings(max_examples=150, deadline=None)
def test_whoever_comes_goes_and_asks_whenever_no_step_and_no_reward_is_lost_or_counted_twice(told, horizon):
    teller = Teller(Experience(BEHAVIOR, horizon))
    for player, ended, asking, update in told:
        said = teller.message(player, ended, asking)
        if update:
            moved = teller.take([said[0]] if said else [])
            said = (moved[0], said[1]) if said else None
        if said:
            teller.experience.act(*said)
    teller.take()
    assert sorted(teller.taken) == sorted(teller.expected)


@given(messages)
@settings(max_examples=60, deadline=None)
def test_it_goes_on_from_its_own_state(told):
    teller = Teller(Experience(BEHAVIOR, 3))
    for player, ended, asking, interrupt in told:
        said = teller.message(player, ended, asking)
        if said:
            teller.experience.act(*said)
        if interrupt:
            state = teller.experience.state_dict()
            teller.experience = Experience(BEHAVIOR, 3)
            teller.experience.load_state_dict(state)
    teller.take()
    assert sorted(teller.taken) == sorted(teller.expected)


def test_a_player_that_begins_anew_leaves_its_open_steps_behind_and_no_others():
    teller = Teller(Experience(BEHAVIOR, 64))
    for player in (0, 1):
        teller.experience.act(*teller.message(player, [], [0, 1]))
    assert len(teller.experience.running) == 4
    teller.experience.begin_anew(0)
    assert len(teller.experience.running) == 2
    teller.message(1, [0, 1], [])
    teller.take()
    assert len(teller.taken) == 2
    assert sorted(teller.taken) == sorted(teller.expected)


def test_a_groups_reward_is_each_members():
    experience = Experience(BEHAVIOR, 64)
    first = agents([0, 1], [0, 1], [0, 0])
    experience.act(experience.ask(0, NAME, first, Observed(first.observations)), decided([0, 0]))
    last = agents([0, 1], [2, 3], [0.5, 1.0], ended=True, group=2.0)
    experience.end(0, NAME, last, last.observations)
    assert [episode.total for episode in experience.ended] == [2.5, 3.0]
    assert experience.take()[0].rewards.tolist() == [2.5, 3.0]


def told(steps, horizon, values, rewards, ends):
    """The transitions of agents in step that see what it is worth; episodes begin in the message that ends others."""
    experience = Experience(BEHAVIOR, horizon)
    count = values.shape[1]
    ids = list(range(count))
    for step in range(steps + 1):
        if step and ends[step - 1].any():
            who = np.flatnonzero(ends[step - 1])
            last = agents(who, np.zeros(len(who)), rewards[step - 1][who], ended=True)
            experience.end(0, NAME, last, last.observations)
        now = agents(ids, values[step], rewards[step - 1] if step else np.zeros(count))
        asked = experience.ask(0, NAME, now, Observed(now.observations))
        if step < steps:
            experience.act(asked, decided(np.arange(count) + count * step))
    return experience.take()[0]


@pytest.mark.parametrize("seed", range(3))
def test_advantages_of_agents_in_step_are_those_of_sb3s_rollout_buffer(seed):
    steps, count, gamma, lambd = 32, 5, 0.97, 0.9
    generator = np.random.default_rng(seed)
    values, rewards = generator.normal(size=(steps + 1, count)), generator.normal(size=(steps, count))
    ends = generator.random((steps, count)) < 0.15
    transitions = told(steps, 10**6, values.astype(np.float32), rewards.astype(np.float32), ends)
    buffer = RolloutBuffer(steps, Box(0, 1, (1,)), Box(0, 1, (1,)), gamma=gamma, gae_lambda=lambd, n_envs=count)
    starts = np.vstack([np.ones(count), ends[:-1]])
    buffer.values[:], buffer.rewards[:], buffer.episode_starts[:] = values[:-1], rewards, starts
    buffer.compute_returns_and_advantage(torch.tensor(values[-1]), ends[-1])
    worth, then = transitions.observed[0][:, 0], transitions.next_observed[0][:, 0]
    found = advantages(transitions.previous, transitions.rewards, worth, then * ~transitions.terminated, gamma, lambd)
    order = transitions.decided.continuous[:, 0].astype(int)  # step by step, agent by agent
    expected = buffer.advantages.ravel()[order]
    assert found == pytest.approx(expected, abs=1e-5)


def test_a_time_horizon_cuts_a_trajectory_and_not_what_follows_it():
    values = np.arange(9, dtype=np.float32)[:, None]
    transitions = told(8, 3, values, np.zeros((8, 1), np.float32), np.zeros((8, 1), bool))
    assert transitions.previous.tolist() == [-1, 0, 1, -1, 3, 4, -1, 6]
    assert transitions.next_observed[0][:, 0].tolist() == [1, 2, 3, 4, 5, 6, 7, 8]


def test_what_was_terminated_is_told_from_what_a_time_limit_or_an_update_cut():
    experience = Experience(BEHAVIOR, 8)
    first = agents([0, 1, 2], [1, 2, 3], [0, 0, 0])
    experience.act(experience.ask(0, NAME, first, Observed(first.observations)), decided([1, 2, 3]))
    ended = agents([0, 1], [4, 5], [0, 0], ended=True, interrupted=[False, True])
    experience.end(0, NAME, ended, ended.observations)
    running = agents([2], [6], [0])
    experience.ask(0, NAME, running, Observed(running.observations))
    transitions, _ = experience.take()
    assert transitions.decided.continuous[:, 0].tolist() == [1, 2, 3]
    assert transitions.terminated.tolist() == [True, False, False]
