"""What a caller of the wrappers does wrong, or is interrupted in, is refused in a sentence, and the player lives on."""

import os
import signal
from pathlib import Path

import numpy as np
import pytest
from conftest import BIN, unused_port
from mlagents_envs.exception import UnityCommunicationException, UnityException, UnityTimeOutException
from simulations.zoo import served

from trainer.errors import TrainerError
from trainer.players.gym_wrapper import UnityGymException, UnityToGymWrapper
from trainer.players.opening import open_environment
from trainer.players.parallel_env import UnityParallelEnv
from trainer.players.vec_env import UnityVecEnv
from trainer.players.vector_env import UnityVectorEnv

CARTPOLE = ("--gym", "CartPole-v1")
FAILING = """
import gymnasium

class Failing(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(0, 1, (1,))
    action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        return self.observation_space.low, {}

    def step(self, action):
        raise RuntimeError("out of paint")

gymnasium.register("Failing-v0", Failing)
"""


@pytest.mark.parametrize("late", ["a timeout", "an interrupt"])
def test_what_is_left_of_a_step_is_no_later_steps_answer(late, free_port, tmp_path):
    """Of CartPole, a first step's observation differs from a reset's and from a second step's."""
    with served(free_port, tmp_path, *CARTPOLE) as environment:
        env = UnityToGymWrapper(environment)
        env.reset()
        os.kill(environment.process_id, signal.SIGSTOP)
        if late == "a timeout":
            environment._communicator._timeout_wait = 0.2
            raised = UnityTimeOutException
        else:
            signal.signal(signal.SIGALRM, lambda *_: signal.default_int_handler(signal.SIGINT, None))
            signal.setitimer(signal.ITIMER_REAL, 0.2)
            raised = KeyboardInterrupt
        with pytest.raises(raised):
            env.step(1)
        os.kill(environment.process_id, signal.SIGCONT)
        environment._communicator._timeout_wait = 30
        with pytest.raises(UnityCommunicationException, match="timed out or was interrupted; call reset"):
            env.step(1)
        began, _ = env.reset()
        assert np.abs(began).max() < 0.05, "a first observation, which a pushed cart's is not"
        after = [env.step(1)[0] for _ in range(3)]
        assert np.all(np.diff([began[1], *(each[1] for each in after)]) > 0.15), "every push speeds the cart up at once"


def test_actions_sent_twice_are_refused_and_a_reset_drops_them(free_port, tmp_path):
    with served(free_port, tmp_path, *CARTPOLE, num_areas=2) as environment:
        env = UnityVecEnv(environment)
        env.reset()
        env.step_async(np.zeros(2, int))
        with pytest.raises(UnityCommunicationException, match="call reset"):
            env.step_async(np.zeros(2, int))
        assert np.abs(env.reset()).max() < 0.05


def test_who_never_resets_is_told_of_ends_all_the_same(free_port, tmp_path):
    with served(free_port, tmp_path, *CARTPOLE, num_areas=3) as environment:
        env = UnityVectorEnv(environment)
        ends = sum(env.step(np.ones(3, int))[2].sum() for _ in range(50))
        assert ends >= 9  # a pole that is pushed one way falls within twelve steps


@pytest.mark.parametrize("choice", [2, -1, 0.5, np.nan, 2**32 + 1, "a", None, [0, 1]])
@pytest.mark.parametrize("wrap", [UnityToGymWrapper, UnityVecEnv, UnityVectorEnv, UnityParallelEnv])
def test_a_choice_that_there_is_not_is_refused_and_the_player_lives_on(wrap, choice, cartpole):
    env = cartpole(wrap)
    with pytest.raises(
        (TrainerError, UnityGymException), match=r"^(Agent CartPole-v1_0|The (action|choice)).* expected"
    ):
        env.step(given(env, choice))
    env.step(given(env, 1))


def given(env, choice):
    """A choice of the only agent as a wrapper takes it."""
    if isinstance(env, UnityParallelEnv):
        return {env.agents[0]: choice}
    return choice if isinstance(env, UnityToGymWrapper) else [choice]


def open_cartpole(folder):
    player, port = str(BIN / "corridor-server"), unused_port()
    return open_environment(
        player, seed=0, num_areas=1, port=port, timeout_wait=60, log_folder=folder, env_args=CARTPOLE
    )


@pytest.fixture(scope="module")
def cartpole(tmp_path_factory):
    """Opens one served CartPole in a wrapper; a wrapper's environment is used again."""
    opened = {}

    def one(wrap):
        if wrap not in opened:
            opened[wrap] = wrap(open_cartpole(tmp_path_factory.mktemp("log")))
            opened[wrap].reset()
        return opened[wrap]

    yield one
    for env in opened.values():
        env.close()


def test_actions_of_another_shape_are_not_reshaped(free_port, tmp_path):
    with served(free_port, tmp_path, num_areas=3) as environment:
        env = UnityVectorEnv(environment)
        env.reset()
        for wrong in (np.zeros((2, 3)), np.zeros(6), np.zeros((3, 3)), [[0, 0], [0], [0, 0]]):
            with pytest.raises(TrainerError, match="^The action.* expected"):
                env.step(wrong)
        env.step(np.zeros((3, 2)))


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"env_args": "--gym CartPole-v1"}, "env_args is '--gym CartPole-v1', but a list of texts was expected"),
        ({"env_args": ["--seed", 3]}, r"env_args is \['--seed', 3\], but a list of texts was expected"),
        ({"num_areas": 0}, "num_areas is 0, but a whole number from 1 to 2147483647 was expected"),
        ({"num_areas": "2"}, "num_areas is '2', but"),
        ({"port": "5005"}, "port is '5005', but a whole number from 1 to 65535 was expected"),
        ({"timeout_wait": None}, "timeout_wait is None, but a number from 0"),
        ({"env": "builtin", "num_areas": 70_000}, "the built-in player has at most 65536"),
    ],
)
def test_arguments_that_cant_be_are_named_before_a_player_is_started(arguments, says, free_port):
    given = {"env": "/bin/false", "seed": 0, "num_areas": 1, "port": free_port, "timeout_wait": 1, **arguments}
    with pytest.raises(TrainerError, match=says):
        open_environment(**given)


def test_a_players_failure_has_the_end_of_its_log_as_a_note(free_port, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "failing.py").write_text(FAILING)
    with served(free_port, tmp_path, "--gym", "failing:Failing-v0") as environment:
        env = UnityToGymWrapper(environment)
        env.reset()
        with pytest.raises(UnityException) as failed:
            env.step(0)
    assert "out of paint" in "".join(failed.value.__notes__)


def test_an_older_log_is_not_quoted(free_port, tmp_path):
    (tmp_path / "Player-0.log").write_text("INFO The trainer ended the session.\n")
    with pytest.raises(TrainerError) as failed:
        open_environment(
            Path("/bin/false"), seed=0, num_areas=1, port=free_port, timeout_wait=20, log_folder=str(tmp_path)
        )
    assert "The trainer ended" not in str(failed.value)
