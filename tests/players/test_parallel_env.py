"""``UnityParallelEnv``: PettingZoo's own check on its own environments, served; who lives, asks, and has which name."""

import importlib
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from conftest import BIN
from gymnasium import spaces
from mlagents_envs.base_env import ActionSpec
from pettingzoo.test import api_test, parallel_api_test
from pettingzoo.utils.conversions import parallel_to_aec
from scripted import Scripted, spec
from simulations.zoo import SEED, served

from corridor_server.shared.patience import MESSAGES_WITHOUT_DECISION
from trainer.errors import TrainerError
from trainer.players.opening import open_environment
from trainer.players.parallel_env import UnityParallelEnv

BUILD = Path(__file__).parents[1] / "unity" / "Build.x86_64"
SERVED = [
    ("mpe2.simple_spread_v3", ["--group"]),
    ("mpe2.simple_tag_v3", ["--team", "agent=1"]),
    ("pettingzoo.butterfly.knights_archers_zombies_v11", []),
]


@pytest.mark.parametrize(("module", "options"), SERVED)
def test_pettingzoos_own_check_passes(module, options, free_port, tmp_path):
    with served(free_port, tmp_path, "--pettingzoo", module, *options) as environment:
        env = UnityParallelEnv(environment)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            parallel_api_test(env, num_cycles=200)


@pytest.mark.parametrize(("module", "options"), SERVED)
def test_agents_are_those_in_process(module, options, free_port, tmp_path):
    """Two episodes, with the same names, observations, rewards and ends."""
    oracle = importlib.import_module(module).parallel_env()
    with served(free_port, tmp_path, "--pettingzoo", module, *options) as environment:
        env = UnityParallelEnv(environment)
        for episode in range(2):
            seen, _ = env.reset()
            expected, _ = oracle.reset(seed=SEED if episode == 0 else None)
            assert sorted(env.agents) == sorted(oracle.agents)
            rng, steps = np.random.default_rng(episode), 0
            while oracle.agents:
                for agent in oracle.agents:
                    parts = seen[agent] if isinstance(seen[agent], dict) else {"obs_0": seen[agent]}
                    assert np.array_equal(parts["obs_0"], expected[agent].astype(np.float32))
                actions = {agent: int(rng.integers(oracle.action_space(agent).n)) for agent in oracle.agents}
                seen, rewards, terminated, truncated, _ = env.step(actions)
                expected, *others = oracle.step(actions)
                for agent in actions:
                    assert np.float32(rewards[agent]) == np.float32(others[0][agent])
                    assert terminated[agent] == bool(others[1][agent])
                    assert truncated[agent] == (bool(others[2][agent]) and not others[1][agent])
                assert sorted(env.agents) == sorted(oracle.agents)
                steps += 1
            assert steps > 10


def parallel(*messages, actions: ActionSpec = ActionSpec.create_continuous(1), shapes=((1,),), **options):  # noqa: B008
    environment = Scripted(spec(list(shapes), actions), list(messages), **options)
    return UnityParallelEnv(environment), environment


@pytest.mark.filterwarnings("ignore::UserWarning")  # of what the protocol carries no bounds
@pytest.mark.parametrize("actions", [ActionSpec.create_discrete((2, 3)), ActionSpec(2, (3, 4))])
def test_masks_are_what_the_action_space_samples_with_as_pettingzoos_test_for_agents_in_turns_does(actions):
    env, _ = parallel(*[({1: 0, 2: 0}, {})] * 400, actions=actions, forbids=lambda *_: first_forbidden(actions))
    api_test(parallel_to_aec(env), num_cycles=50)
    _, infos = env.reset()
    for _ in range(20):
        choices = env.action_space("Scripted_0").sample(infos["Scripted_0"]["action_mask"])
        assert np.all(choices[1] if actions.continuous_size else choices)


def first_forbidden(actions: ActionSpec) -> list[list[bool]]:
    return [[choice == 0 for choice in range(size)] for size in actions.discrete_branches]


def test_an_environment_that_is_refused_is_closed():
    environment = Scripted(spec([(1,)], ActionSpec(0, ())), [({1: 0}, {})])
    with pytest.raises(TrainerError, match="has no action"):
        UnityParallelEnv(environment)
    assert environment.closed


def act(env: UnityParallelEnv, **actions):
    return env.step({agent: np.array([value], np.float32) for agent, value in actions.items()})


def test_an_agent_that_ends_is_gone_until_the_reset_whatever_it_does_then():
    env, environment = parallel(
        ({4: 0, 7: 0}, {}),
        ({4: 0.5, 7: 9.0}, {7: (-1.0, False)}),  # it begins its next episode at once
        ({4: 0.25, 7: 9.0}, {}),
        ({4: 9.0}, {4: (1.0, True)}),
        ({7: 0, 4: 0}, {}),
        group_reward=0.125,
    )
    observations, infos = env.reset()
    assert (env.agents, infos) == (["Scripted_0", "Scripted_1"], {"Scripted_0": {}, "Scripted_1": {}})
    assert observations["Scripted_1"] == pytest.approx([7.0])
    observations, rewards, terminated, truncated, infos = act(env, Scripted_0=0.1, Scripted_1=0.2)
    assert rewards == {"Scripted_0": 0.625, "Scripted_1": -0.875}
    assert (terminated["Scripted_1"], truncated["Scripted_1"], terminated["Scripted_0"]) == (True, False, False)
    assert observations["Scripted_1"] == pytest.approx([7.01])
    assert env.agents == ["Scripted_0"]
    assert act(env, Scripted_0=0.3)[1] == {"Scripted_0": 0.375}
    assert environment.sent[1].continuous[:, 0] == pytest.approx([0.3, 0.0])
    _, rewards, terminated, truncated, _ = act(env, Scripted_0=0.4)
    assert (rewards, terminated, truncated) == ({"Scripted_0": 1.125}, {"Scripted_0": False}, {"Scripted_0": True})
    assert env.agents == []
    assert env.step({}) == ({}, {}, {}, {}, {})
    observations, _ = env.reset()
    assert observations == {"Scripted_1": pytest.approx([7.04]), "Scripted_0": pytest.approx([4.04])}


def test_a_new_id_after_an_end_is_a_successor_and_any_other_joins():
    env, _ = parallel(
        ({1: 0}, {}),
        ({1: 0, 2: 0.0}, {}),
        ({2: 0}, {1: (1.0, False)}),
        ({2: 0, 3: 0}, {}),  # in 1's place
        ({2: 0, 3: 0, 4: 0}, {}),
        ({5: 0, 6: 0}, {}),
    )
    env.reset()
    observations, *_ = act(env, Scripted_0=0)
    assert (env.agents, sorted(observations)) == (["Scripted_0", "Scripted_1"], ["Scripted_0", "Scripted_1"])
    act(env, Scripted_0=0, Scripted_1=0)
    assert env.agents == ["Scripted_1"]
    act(env, Scripted_1=0)
    assert env.agents == ["Scripted_1"]
    act(env, Scripted_1=0)
    assert env.agents == ["Scripted_1", "Scripted_2"]
    env.reset()
    assert env.agents == ["Scripted_0", "Scripted_1"], "new ids in a new episode take the names anew"
    assert env.possible_agents == ["Scripted_0", "Scripted_1", "Scripted_2"]


def test_an_ended_agent_that_begins_anew_leaves_no_place_for_a_successor():
    env, _ = parallel(({1: 0, 2: 0}, {}), ({1: 0, 2: 0}, {1: (0.0, False)}), ({1: 0, 2: 0, 3: 0}, {}))
    env.reset()
    act(env, Scripted_0=0, Scripted_1=0)
    act(env, Scripted_1=0)
    assert env.agents == ["Scripted_1", "Scripted_2"]


def test_a_step_ends_where_an_agent_comes_whose_action_nobody_has_chosen():
    env, environment = parallel(({1: 0}, {}), ({2: 9.0}, {}), ({1: 0.5}, {}), ({2: 0.25}, {}))
    env.reset()
    observations, rewards, *_ = act(env, Scripted_0=0.1)
    assert observations == {"Scripted_0": pytest.approx([1.0]), "Scripted_1": pytest.approx([2.01])}
    assert rewards == {"Scripted_0": 0, "Scripted_1": 0}
    _, rewards, *_ = act(env, Scripted_0=0.2, Scripted_1=0.3)
    assert [each.continuous.tolist() for each in environment.sent[1:]] == [
        [pytest.approx([0.3])],
        [pytest.approx([0.2])],
    ]
    assert rewards == {"Scripted_0": 0.5, "Scripted_1": 0.25}


def test_an_agent_keeps_its_name_in_the_next_episode_whoever_comes_before_it():
    env, _ = parallel(({2: 0}, {}), ({2: 0}, {}), ({9: 0, 2: 0}, {}))
    env.reset()
    act(env, Scripted_0=0)
    assert env.reset()[0] == {"Scripted_0": pytest.approx([2.02]), "Scripted_1": pytest.approx([9.02])}


def test_a_step_runs_until_every_agent_asked_again():
    env, environment = parallel(
        ({1: 0, 2: 0}, {}), ({1: 0.5}, {}), ({1: 0.25}, {}), ({2: 1.0}, {}), ({1: 0.125}, {}), ({1: 0, 2: 2.0}, {})
    )
    env.reset()
    observations, rewards, *_ = act(env, Scripted_0=0.1, Scripted_1=0.2)
    assert [each.continuous[:, 0].tolist() for each in environment.sent] == [
        pytest.approx([0.1, 0.2]),
        pytest.approx([0.1]),
        pytest.approx([0.1]),
    ]
    assert rewards == {"Scripted_0": 0.75, "Scripted_1": 1.0}
    assert (observations["Scripted_0"], observations["Scripted_1"]) == (pytest.approx([1.02]), pytest.approx([2.03]))
    _, rewards, *_ = act(env, Scripted_0=0.3, Scripted_1=0.4)
    assert [each.continuous[:, 0].tolist() for each in environment.sent[3:]] == [
        pytest.approx([0.4]),
        pytest.approx([0.3]),
    ]
    assert rewards == {"Scripted_0": 0.125, "Scripted_1": 2.0}


def test_masks_are_in_infos_and_a_repeated_choice_keeps_to_them():
    env, environment = parallel(
        ({1: 0, 2: 0}, {}), ({1: 0}, {}), ({1: 0, 2: 0}, {}), ({1: 0}, {2: (0.0, False)}),
        actions=ActionSpec.create_discrete((2, 3)),
        forbids=lambda agent, message: [[False, message == 1], [True, False, False]],
    )  # fmt: skip
    _, infos = env.reset()
    assert [branch.tolist() for branch in infos["Scripted_0"]["action_mask"]] == [[1, 1], [0, 1, 1]]
    assert {branch.dtype for branch in infos["Scripted_0"]["action_mask"]} == {np.dtype(np.int8)}
    env.step({"Scripted_0": np.array([1, 2]), "Scripted_1": np.array([1, 0])})
    assert environment.sent[0].discrete.tolist() == [[1, 2], [1, 0]], "what is chosen is sent as it is"
    assert environment.sent[1].discrete.tolist() == [[0, 2]]
    infos = env.step({"Scripted_0": np.array([1, 2]), "Scripted_1": np.array([1, 0])})[4]
    assert {agent: sorted(info) for agent, info in infos.items()} == {"Scripted_0": ["action_mask"], "Scripted_1": []}


def test_all_kinds_of_observations_and_actions():
    env, environment = parallel(
        ({1: 0}, {}), ({1: 0}, {}), actions=ActionSpec(2, (3, 4)), shapes=((4, 5, 3), (2,), (6, 2))
    )
    observations, _ = env.reset()
    assert {name: part.shape for name, part in observations["Scripted_0"].items()} == {
        "obs_0": (4, 5, 3), "obs_1": (2,), "obs_2": (6, 2)
    }  # fmt: skip
    space = env.action_space("Scripted_0")
    assert space == spaces.Tuple((spaces.Box(-1, 1, (2,), np.float32), spaces.MultiDiscrete([3, 4])))
    env.step({"Scripted_0": ([0.5, -0.5], [2, 3])})
    assert environment.sent[0].discrete.tolist() == [[2, 3]]
    assert environment.sent[0].continuous.tolist() == [[0.5, -0.5]]


def test_what_cant_be_played_is_one_sentence():
    env, _ = parallel(({1: 0, 2: 0}, {}), *[({1: 0.0}, {})] * MESSAGES_WITHOUT_DECISION)
    with pytest.raises(TrainerError, match="Scripted_1 has no action, but one for each of Scripted_0, Scripted_1"):
        act(env, Scripted_0=0)
    for actions in (None, "a"):
        with pytest.raises(TrainerError, match="but a dict of one for Scripted_0, Scripted_1 each was expected"):
            env.step(actions)
    with pytest.raises(TrainerError, match="Scripted_0 has no action"):
        env.step({"Scripted_0": None, "Scripted_1": [0.0]})
    with pytest.raises(TrainerError, match="Agent Scripted_1: The action is 'a', but numbers of shape"):
        env.step({"Scripted_0": [0.0], "Scripted_1": "a"})
    with pytest.raises(TrainerError, match="The action of Scripted_1 is .nan., but finite numbers"):
        act(env, Scripted_0=0, Scripted_1=float("nan"))
    with pytest.raises(TrainerError, match="Scripted_1 neither asked for a decision nor ended in 1000 messages"):
        act(env, Scripted_0=0, Scripted_1=0)
    env.close()
    with pytest.raises(TrainerError, match="The environment is closed"):
        act(env, Scripted_0=0, Scripted_1=0)


@pytest.mark.parametrize(
    ("scene", "names"),
    [
        ("two_behaviors", {"Walker_0", "Walker_1", "Chooser_0"}),
        ("teams", {"Soccer_0", "Soccer_1", "Soccer_2", "Soccer_3"}),
        ("uneven", {"Uneven_0", "Uneven_1", "Uneven_2", "Uneven_3"}),
        ("hybrid", {"Hybrid_0", "Hybrid_1"}),
        ("groups", {f"PushBlock_{number}" for number in range(5)}),
        ("late_behavior", {"Early_0", "Late_0"}),
        ("single_turns", {"Turns_0", "Turns_1"}),
        ("agents_come_and_go", {f"Mayfly_{number}" for number in range(4)}),
    ],
)
def test_scenes_as_unity_has_them(scene, names, free_port, monkeypatch):
    monkeypatch.setenv("PATH", str(BIN), prepend=":")
    environment = open_environment(
        str(BUILD), seed=0, num_areas=1, port=free_port, timeout_wait=60, env_args=["--spec", scene]
    )
    env, seen, ended = UnityParallelEnv(environment), set(), 0
    env.reset()
    for _ in range(120):
        seen |= set(env.agents)
        actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        observations, _, terminated, truncated, _ = env.step(actions)
        assert all(env.observation_space(agent).contains(each) for agent, each in observations.items())
        ended += sum(terminated.values()) + sum(truncated.values())
        if not env.agents:
            env.reset()
    env.close()
    env.close()  # has no effect
    assert seen == names
    assert ended > 0


def test_without_pettingzoo_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pettingzoo", None)
    monkeypatch.delitem(sys.modules, "trainer.players.parallel_env")
    with pytest.raises(ModuleNotFoundError, match="needs pettingzoo, which is not installed: pip install 'curious-"):
        importlib.import_module("trainer.players.parallel_env")
