"""Gymnasium environments that raise, die, hang, or give what can't be used."""

import os
import signal

import numpy as np
import pytest
from gymnasium import spaces
from simulations.counting import Count, answer

from corridor_server.simulations.simulation import SimulationError


def failing(where, raised):
    class Failing(Count):
        def __init__(self):
            super().__init__()
            if where == "constructor":
                raise raised

        def reset(self, **options):
            if where == "reset":
                raise raised
            return super().reset(**options)

        def step(self, action):
            if where == "step":
                raise raised
            return super().step(action)

    return Failing


def run(simulation):
    simulation.reset()
    answer(simulation)


@pytest.mark.parametrize("mode", ["sync", "async"])
@pytest.mark.parametrize(
    ("where", "said"), [("constructor", "can't be made"), ("reset", "failed in a reset"), ("step", "failed in a step")]
)
@pytest.mark.filterwarnings("ignore:.*(Received the following error|Traceback|Raising the last)")
def test_an_environment_that_raises_is_named_with_its_own_words_in_one_line(where, said, mode, play_gymnasium):
    with pytest.raises(SimulationError) as caught:
        run(play_gymnasium(failing(where, ValueError("no\n fuel")), mode=mode))
    assert str(caught.value) == f"Mine0-v0 {said} (ValueError: no fuel)."
    assert isinstance(caught.value.__cause__, ValueError)


@pytest.mark.parametrize("raised", [SystemExit(3), KeyboardInterrupt(3), GeneratorExit(3), BaseException(3)])
def test_an_environment_that_would_end_the_process_has_failed(raised, play_gymnasium, caplog):
    name = type(raised).__name__
    with pytest.raises(SimulationError, match=rf"failed in a step \({name}: 3\)"):
        run(play_gymnasium(failing("step", raised)))

    class Unclosable(Count):
        def close(self):
            raise raised

    play_gymnasium(Unclosable).close()
    assert f"failed when it was closed ({name}: 3)." in caplog.text


def test_a_stop_of_the_player_in_the_middle_of_a_step_is_no_failure_of_the_environment(play_gymnasium):
    from corridor_server.main import Stopped

    with pytest.raises(Stopped):
        run(play_gymnasium(failing("step", Stopped("Stopped by SIGTERM"))))


@pytest.mark.parametrize("mode", ["sync", "async"])
@pytest.mark.parametrize(
    ("given", "said"),
    [
        ([0.7, -1.5], "observation of float64 came, but int16 was expected"),
        ([40000, 5], "observation has 40000, which int16 can't hold"),
        (["1", "2"], "observation of <U1 came, but int16 was expected"),
        ([1, 2j], "observation of complex128 came, but int16 was expected"),
    ],
)
@pytest.mark.filterwarnings("ignore:.*(Received the following error|Traceback|Raising the last)")
def test_numbers_that_the_spaces_type_cant_hold_are_refused_in_any_process(given, said, mode, play_gymnasium):
    class Rounded(Count):
        observation_space = spaces.Box(-30000, 30000, (2,), np.int16)

        def reset(self, **options):
            super().reset(**options)
            return np.array([1, 2]), {}

        def step(self, action):
            return np.array(given), *super().step(action)[1:]

    simulation = play_gymnasium(Rounded, mode=mode)
    with pytest.raises(SimulationError, match=rf"failed in a step \(ValueError: {said}"):
        run(simulation)


def test_what_float32_cant_hold_is_named_as_it_was_given(play_gymnasium):
    class Huge(Count):
        observation_space = spaces.Box(-np.inf, np.inf, (2,), np.float64)

        def reset(self, **options):
            super().reset(**options)
            return np.array([1.0, -8e299]), {}

    said = r"gave agent 0 observation\[1\] = -8e\+299, but numbers that float32 can hold were expected"
    with pytest.raises(SimulationError, match=said):
        play_gymnasium(Huge).reset()


def test_what_is_too_small_for_float32_is_0_though_the_environment_has_numpy_raise_then(play_gymnasium):
    class Strict(Count):
        observation_space = spaces.Box(-np.inf, np.inf, (1,), np.float64)

        def reset(self, **options):
            super().reset(**options)
            return np.array([1e-50]), {}

        def step(self, action):
            return np.array([1e-50]), 1e-50, *super().step(action)[2:]

    with np.errstate(all="raise"):
        simulation = play_gymnasium(Strict)
        simulation.reset()
        _, agents = answer(simulation)
    assert not agents.rewards.any()
    assert not agents.observations[0].any()


@pytest.mark.parametrize("at", ["step", "reset"])
def test_a_process_that_dies_is_a_failure_and_leaves_nothing_behind(at, play_gymnasium):
    class Dying(Count):
        def reset(self, **options):
            if at == "reset" and self.seen[0]:
                os.kill(os.getpid(), signal.SIGKILL)
            return super().reset(**options)

        def step(self, action):
            if at == "step" and self.seen[1] == 1:
                os.kill(os.getpid(), signal.SIGKILL)
            return super().step(action)

    simulation = play_gymnasium(Dying, mode="async")
    simulation.reset()
    answer(simulation)
    with pytest.raises(SimulationError, match=rf"failed in a {at} \(.*(its process ended|Connection|pipe)"):
        [answer(simulation) for _ in range(2)]
    simulation.close()
    for process in simulation._copies.vector.processes:
        process.join(10)
        assert not process.is_alive()


def test_a_copys_process_is_no_fork_of_the_player_which_has_threads_and_a_socket(play_gymnasium):
    """A fork of it crashed now and then, and kept the trainer from hearing that the player was gone."""
    [process, _] = play_gymnasium(mode="async")._copies.vector.processes
    assert type(process).__name__ == "ForkServerProcess"


def test_a_copy_at_work_does_not_keep_the_player_from_closing(play_gymnasium):
    class Hanging(Count):
        def step(self, action):
            signal.pause()

    simulation = play_gymnasium(Hanging, mode="async", num_areas=1)
    simulation.reset()
    simulation._copies.vector.step_async(np.array([0]))
    simulation.close()
    assert not simulation._copies.vector.processes[0].is_alive()


def test_an_environment_that_raises_when_it_is_closed_does_no_harm(play_gymnasium, caplog):
    class Unclosable(Count):
        tried = 0

        def close(self):
            Unclosable.tried += 1
            raise RuntimeError("never")

    simulation = play_gymnasium(Unclosable)
    simulation.close()
    assert "Mine0-v0 failed when it was closed (RuntimeError: never)." in caplog.text
    assert Unclosable.tried == 2  # the other copy has been tried, too


def given(observation=None, reward=0.0, at=1):
    """An environment that gives these at a step; 0 is its reset."""

    class Given(Count):
        observation_space = spaces.Dict({"eye": spaces.Box(-1, 1, (2, 2)), "which": spaces.Discrete(3)})

        def seen_at(self, step):
            usual = {"eye": np.zeros((2, 2), np.float32), "which": 0}
            return usual | observation if observation is not None and step == at else usual

        def reset(self, **options):
            super().reset(**options)
            return self.seen_at(0), {}

        def step(self, action):
            super().step(action)
            return self.seen_at(self.seen[1]), reward, False, False, {}

    return Given


@pytest.mark.parametrize("at", [0, 1])
@pytest.mark.parametrize(
    ("observation", "said"),
    [
        ({"eye": np.array([[0, 0], [np.nan, 0]], np.float32)}, r"gave agent 0 eye\[1, 0\] = nan, but finite"),
        ({"eye": np.array([[0, 0], [0, 1e300]])}, r"gave agent 0 eye\[1, 1\] = inf, but finite"),
        ({"which": 3}, r"gave which = 3, but 0 to 2 were expected"),
        ({"which": -1}, r"gave which = -1, but 0 to 2 were expected"),
        ({"which": 0.5}, "failed in a (reset|step)"),
        ({"eye": np.zeros((3, 2), np.float32)}, "failed in a (reset|step)"),
        ({"eye": np.zeros(4, np.float32)}, "failed in a (reset|step)"),
        ({"eye": None}, "failed in a (reset|step)"),
    ],
)
@pytest.mark.filterwarnings("ignore:overflow encountered in cast")
def test_an_observation_that_is_none_of_the_space_is_refused(observation, said, at, play_gymnasium):
    with pytest.raises(SimulationError, match=said):
        run(play_gymnasium(given(observation, at=at)))


@pytest.mark.parametrize("at", [0, 1])
@pytest.mark.parametrize("mode", ["sync", "async"])
@pytest.mark.filterwarnings("ignore:.*(Received the following error|Traceback|Raising the last)")
def test_an_observation_of_another_shape_is_named_with_both(mode, at, play_gymnasium):
    with pytest.raises(SimulationError) as caught:
        run(play_gymnasium(given({"eye": np.zeros(3, np.float32)}, at=at), mode=mode))
    when = "step" if at else "reset"
    assert str(caught.value) == (
        f"Mine0-v0 failed in a {when} (ValueError: eye of shape (3,) came, but (2, 2) was expected)."
    )


def test_copies_of_different_spaces_are_refused(play_gymnasium):
    class Growing(Count):
        made = 0

        def __init__(self):
            super().__init__()
            Growing.made += 1
            self.action_space = spaces.Discrete(Growing.made)

    with pytest.raises(SimulationError, match="Copy 1 of the environment has other spaces than copy 0, but"):
        play_gymnasium(Growing)


@pytest.mark.parametrize("reward", [np.nan, np.inf, -np.inf, 1e300])
def test_a_reward_that_is_no_number_is_named(reward, play_gymnasium):
    expected = "numbers that float32 can hold" if reward == 1e300 else "finite numbers"
    with pytest.raises(SimulationError) as caught:
        run(play_gymnasium(given(reward=reward)))
    assert str(caught.value) == f"The environment gave agent 0 a reward = {reward}, but {expected} were expected."


@pytest.mark.parametrize("reward", ["much", [1.0, 2.0], {}, None, 1j, np.complex64(1j)])
def test_a_reward_of_another_kind_is_a_failure_that_shows_it(reward, play_gymnasium):
    with pytest.raises(SimulationError, match=r"failed in a step \(ValueError: a reward is .*, but a number was exp"):
        run(play_gymnasium(given(reward=reward)))


def test_lists_and_pythons_numbers_are_observations_too(play_gymnasium):
    simulation = play_gymnasium(given({"eye": [[0.5, 1], [True, 0]], "which": np.int8(2)}))
    simulation.reset()
    _, asking = answer(simulation)
    assert asking.observations[0][0].tolist() == [[0.5, 1], [1, 0]]
    assert asking.observations[1][0].tolist() == [0, 0, 1]


@pytest.mark.parametrize("mode", ["sync", "async"])
@pytest.mark.parametrize("over", [True, np.array([True])])
def test_an_end_may_be_anything_that_is_true_in_any_process(over, mode, play_gymnasium):
    class Ending(Count):
        def step(self, action):
            observation, reward, _, _, info = super().step(action)
            return observation, reward, over, np.array(False), info

    simulation = play_gymnasium(Ending, mode=mode)
    simulation.reset()
    ended, asking = answer(simulation)
    assert ended.ids.tolist() == asking.ids.tolist() == [0, 1]
    assert not ended.interrupted.any()
