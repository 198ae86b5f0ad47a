"""Copies of a Gymnasium environment as agents: who asks, who ended, with what."""

import os
import signal
import sys
import types

import gymnasium
import numpy as np
import pytest
from gymnasium import spaces

from corridor_server.protocol.agents import ActionBatch
from corridor_server.protocol.samplers import Uniform
from corridor_server.simulations.gymnasium_simulation import GymnasiumEnvironment, GymnasiumSimulation
from corridor_server.simulations.simulation import SimulationError

VECTOR = spaces.Box(-np.inf, np.inf, (3,))


class Count(gymnasium.Env):
    """Observes [episode, step, a number drawn when the episode began] in one array that it goes on writing into."""

    metadata = {"render_modes": ["rgb_array"]}  # noqa: RUF012 - Gymnasium's
    observation_space = VECTOR
    action_space = spaces.Discrete(3)

    def __init__(self, length=3, ends="terminated", render_mode=None):
        self.length, self.ends, self.render_mode = length, ends, render_mode
        self.gravity, self.seen, self.seeds = 9.8, np.zeros(3, np.float32), []
        self.half = np.float32(0.5)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        assert options is None
        self.seeds.append(seed)
        self.seen[:] = self.seen[0] + 1, 0, self.np_random.random()
        return self.seen, self.info()

    def step(self, action):
        self.seen[1] += 1
        over = self.seen[1] == self.length
        terminated, truncated = over and self.ends != "truncated", over and self.ends != "terminated"
        return self.seen, 10 * self.seen[1] + action, terminated, truncated, self.info()

    def info(self):
        return {}

    def render(self):
        return np.full((40, 60, 3), 200, np.uint8)


@pytest.fixture
def register():
    """Registers a class, with which an environment is then made."""
    names = []

    def named(kind, **options):
        names.append(f"Mine{len(names)}-v0")
        gymnasium.register(names[-1], kind, **options)
        return names[-1]

    yield named
    for name in names:
        del gymnasium.registry[name]


@pytest.fixture
def play(register):
    """Makes a simulation, which is closed at the end."""
    opened = []

    def one(kind=Count, num_areas=2, seed=0, **options):
        name = kind if isinstance(kind, str) else register(kind)
        opened.append(GymnasiumSimulation(GymnasiumEnvironment(name, **options), seed, num_areas))
        return opened[-1]

    yield one
    for simulation in opened:
        simulation.close()


def only(moment):
    [agents] = moment.values()
    return agents


def answer(simulation, discrete=0, continuous=0.0):
    """Steps with the same action for all; returns those that ended and those that ask."""
    [(name, behavior)] = simulation.behaviors.items()
    count = len(simulation._ids)
    numbers = np.full((count, behavior.continuous_actions), continuous, np.float32)
    choices = np.full((count, len(behavior.discrete_branches)), discrete, np.int32)
    moment, statistics = simulation.step({name: ActionBatch(numbers, choices)})
    assert statistics == {}
    agents = only(moment)
    ended = len(agents.ended)
    assert agents.done.tolist() == [True] * ended + [False] * count  # ends stand before requests
    return agents.ended, agents.deciding


def test_the_behavior_is_named_after_the_id_without_its_module(play):
    assert list(play("CartPole-v1").behaviors) == ["CartPole-v1?team=0"]
    assert list(play("gymnasium.envs.classic_control:CartPole-v1").behaviors) == ["CartPole-v1?team=0"]


def test_ids_are_the_copies_numbers_for_life(play):
    simulation = play(num_areas=3)
    assert only(simulation.reset()).ids.tolist() == [0, 1, 2]
    for step in range(1, 10):
        ended, asking = answer(simulation)
        assert asking.ids.tolist() == [0, 1, 2]
        assert ended.ids.tolist() == ([0, 1, 2] if step % 3 == 0 else [])
    assert only(simulation.reset()).ids.tolist() == [0, 1, 2]


def test_the_end_has_the_last_observation_and_reward_and_the_begun_episode_its_first_and_none(play):
    simulation = play()
    only(simulation.reset())
    answer(simulation)
    answer(simulation)
    ended, asking = answer(simulation, discrete=2)
    assert ended.observations[0][:, :2].tolist() == [[1, 3]] * 2
    assert ended.rewards.tolist() == [32, 32]
    assert asking.observations[0][:, :2].tolist() == [[2, 0]] * 2
    assert asking.rewards.tolist() == [0, 0]
    assert (asking.observations[0][:, 2] != ended.observations[0][:, 2]).all()


def test_only_copies_that_ended_begin_anew(play):
    simulation = play()
    simulation._envs.envs[1].unwrapped.length = 2
    simulation.reset()
    answer(simulation)
    ended, asking = answer(simulation, discrete=1)
    assert ended.ids.tolist() == [1]
    assert asking.observations[0][:, :2].tolist() == [[1, 2], [2, 0]]
    assert asking.rewards.tolist() == [21, 0]


@pytest.mark.parametrize(("ends", "interrupted"), [("terminated", False), ("truncated", True), ("both", False)])
def test_an_end_is_interrupted_only_if_nothing_but_a_limit_ended_it(ends, interrupted, play):
    simulation = play(arguments={"ends": ends, "length": 1})
    simulation.reset()
    ended, asking = answer(simulation)
    assert ended.interrupted.tolist() == [interrupted] * 2
    assert not asking.interrupted.any()


def test_a_reset_keeps_an_episode_that_began_by_itself_and_has_not_moved(play):
    simulation = play(arguments={"length": 1})
    simulation.reset()
    _, asking = answer(simulation)
    kept = only(simulation.reset())
    assert np.array_equal(kept.observations[0], asking.observations[0])
    assert kept.observations[0][:, 0].tolist() == [2, 2]
    assert only(simulation.reset()).observations[0][:, 0].tolist() == [3, 3]


def test_a_reset_in_mid_episode_begins_one_without_an_end_but_where_one_just_began(play):
    simulation = play()
    simulation._envs.envs[1].unwrapped.length = 1
    simulation.reset()
    answer(simulation)
    begun = only(simulation.reset())
    assert begun.observations[0][:, :2].tolist() == [[2, 0], [2, 0]]
    assert not begun.done.any()
    assert begun.rewards.tolist() == [0, 0]


@pytest.mark.parametrize(
    ("seed", "expected"),
    [(5, [5, 6]), (2**31 - 1, [2**31 - 1, 2**31]), (-1, [2**32 - 1, 0]), (-(2**31), [2**31, 2**31 + 1])],
)
def test_a_copys_seed_is_the_trainers_and_its_number_and_only_its_first_reset_has_it(seed, expected, play):
    simulation = play(seed=seed, arguments={"length": 1})
    simulation.reset()
    answer(simulation)
    seeds = [env.unwrapped.seeds for env in simulation._envs.envs]
    assert seeds == [[expected[0], None], [expected[1], None]]


@pytest.mark.parametrize("mode", ["sync", "async"])
def test_it_is_the_environment_in_process_with_the_same_seeds(mode, play):
    simulation = play("CartPole-v1", seed=3, mode=mode)
    envs = [gymnasium.make("CartPole-v1") for _ in range(2)]
    expected, ends = np.array([env.reset(seed=3 + area)[0] for area, env in enumerate(envs)]), 0
    asking, rng = only(simulation.reset()), np.random.default_rng(0)
    for _ in range(60):
        assert np.array_equal(asking.observations[0], expected)
        choices = rng.integers(2, size=(2, 1), dtype=np.int32)
        moment, _ = simulation.step({"CartPole-v1?team=0": ActionBatch(np.zeros((2, 0), np.float32), choices)})
        ended, asking = only(moment).ended, only(moment).deciding
        last = {}
        for area, env in enumerate(envs):
            expected[area], reward, terminated, truncated, _ = env.step(int(choices[area, 0]))
            if terminated or truncated:
                last[area] = (expected[area].tolist(), reward)
                expected[area] = env.reset()[0]
        assert ended.ids.tolist() == list(last)
        assert [*zip(ended.observations[0].tolist(), ended.rewards.tolist(), strict=True)] == [*last.values()]
        ends += len(last)
    assert ends > 1


def test_rewards_and_ends_of_other_kinds_are_numbers_and_flags_as_well(play):
    class OneElement(Count):
        def step(self, action):
            seen, reward, terminated, truncated, info = super().step(action)
            return seen.tolist(), np.array([reward]), terminated, int(truncated), info

    simulation = play(OneElement)
    simulation.reset()
    assert answer(simulation)[1].rewards.tolist() == [10, 10]


# Pictures.


def test_the_camera_adds_a_picture_scaled_to_its_size(play):
    class Halves(Count):
        def render(self):
            picture = np.zeros((40, 60, 3), np.uint8)
            picture[:20] = 255, 0, 0
            picture[20:, 30:] = 0, 0, 100
            return picture

    simulation = play(Halves, camera=(2, 2))
    sensors = {sensor.name: at for at, sensor in enumerate(simulation._behavior.sensors)}
    assert sensors.keys() == {"CameraSensor", "observation"}
    picture = only(simulation.reset()).observations[sensors["CameraSensor"]]
    assert picture.dtype == np.uint8
    assert picture[0].tolist() == [[[255, 0, 0], [255, 0, 0]], [[0, 0, 0], [0, 0, 100]]]
    assert only(simulation.reset()).observations[sensors["observation"]].shape == (2, 3)


@pytest.mark.parametrize("size", [(1, 1), (7, 3), (60, 40), (64, 128)])
def test_a_picture_of_one_colour_keeps_it_at_any_size(size, play):
    picture = only(play(camera=size).reset()).observations[0]
    assert picture.shape == (2, size[1], size[0], 3)
    assert (picture == 200).all()


def test_a_pixel_is_the_mean_of_those_that_it_covers(play):
    class Ramp(Count):
        def render(self):
            return np.arange(8, dtype=np.uint8).reshape(2, 4, 1) * np.ones(3, np.uint8) * 10

    assert only(play(Ramp, camera=(2, 1)).reset()).observations[0][0, 0, :, 0].tolist() == [25, 45]


def test_the_camera_is_beside_the_parts_of_a_dict(play):
    class Parts(Count):
        observation_space = spaces.Dict({"a": VECTOR, "action_mask": spaces.MultiBinary(3)})

        def reset(self, **options):
            return {"a": super().reset(**options)[0], "action_mask": np.array([1, 0, 1], np.int8)}, {}

    agents = only(play(Parts, camera=(2, 2)).reset())
    assert [each.shape for each in agents.observations] == [(2, 2, 2, 3), (2, 3)]
    assert agents.masks[0].tolist() == [[False, True, False]] * 2


@pytest.mark.parametrize(
    ("picture", "shape"), [(None, r"object of shape \(\)"), (np.zeros((4, 4), np.uint8), r"uint8 of shape \(4, 4\)")]
)
def test_a_camera_of_an_environment_that_cant_render_is_refused(picture, shape, play):
    class Dark(Count):
        def render(self):
            return picture

    with pytest.raises(SimulationError, match=f"--camera: the environment renders {shape}, but uint8 of shape"):
        play(Dark, camera=(4, 4)).reset()


def test_the_camera_is_beside_what_wrappers_leave_to_observe(play):
    """Around the camera they would flatten its picture, too."""
    agents = only(play(wrappers=("gymnasium.wrappers:FlattenObservation",), camera=(4, 2)).reset())
    assert [each.shape for each in agents.observations] == [(2, 2, 4, 3), (2, 3)]


# Masks.


def masked(*given):
    """An environment whose info holds these in turn, from reset on; None holds none."""

    class Masked(Count):
        action_space = spaces.MultiDiscrete([2, 3])

        def step(self, action):
            return super().step(0)

        def info(self):
            self.told = getattr(self, "told", -1) + 1
            mask = given[self.told % len(given)]
            return {} if mask is None else {"action_mask": mask}

    return Masked


FORBIDDEN = [[[False, True]], [[True, False, False]]]
ALLOWED = [[[False, False]], [[False, False, False]]]


@pytest.mark.parametrize(
    "mask",
    [
        np.array([1, 0, 0, 1, 1], np.int8),
        [True, False, False, True, True],
        (np.array([1, 0], np.int8), np.array([0, 1, 1], np.int8)),
        [[1, 0], [0, 1, 1]],
    ],
)
def test_an_infos_mask_forbids_whether_it_is_one_array_or_one_per_branch(mask, play):
    simulation = play(masked(mask), num_areas=1, mode="async" if isinstance(mask, tuple) else "sync")
    assert [each.tolist() for each in only(simulation.reset()).masks] == FORBIDDEN
    assert [each.tolist() for each in answer(simulation)[1].masks] == FORBIDDEN


def test_who_gives_a_mask_only_sometimes_or_late_may_do_anything_without_one(play):
    simulation = play(masked(None, np.array([1, 0, 0, 1, 1]), None), num_areas=1)
    assert only(simulation.reset()).masks == ()
    assert [each.tolist() for each in answer(simulation)[1].masks] == FORBIDDEN
    assert [each.tolist() for each in answer(simulation)[1].masks] == ALLOWED


def test_a_mask_of_none_is_none(play):
    class Nothing(Count):
        def info(self):
            return {"action_mask": None}

    assert only(play(Nothing).reset()).masks == ()


def test_a_mask_is_of_its_own_copy_and_its_running_episode(play):
    """Copies end at different steps; those that go on keep their masks when another begins."""

    class ByStep(Count):
        def info(self):
            mask = np.ones(3, np.int8)
            mask[int(self.seen[1])] = 0
            return {"action_mask": mask}

    simulation = play(ByStep)
    simulation._envs.envs[1].unwrapped.length = 2
    assert np.argmax(only(simulation.reset()).masks[0], axis=1).tolist() == [0, 0]
    assert np.argmax(answer(simulation)[1].masks[0], axis=1).tolist() == [1, 1]
    ended, asking = answer(simulation)
    assert not ended.masks[0].any()  # nobody chooses any more
    assert np.argmax(asking.masks[0], axis=1).tolist() == [2, 0]


def test_an_observed_mask_forbids_and_is_no_observation(play):
    class Observed(Count):
        observation_space = spaces.Dict({"action_mask": spaces.Box(0, 1, (3,), np.int8), "seen": VECTOR})

        def reset(self, **options):
            return {"action_mask": np.array([0, 1, 1], np.int8), "seen": super().reset(**options)[0]}, {}

    agents = only(play(Observed).reset())
    assert agents.masks[0].tolist() == [[True, False, False]] * 2
    assert [each.shape for each in agents.observations] == [(2, 3)]


def test_a_mask_without_choices_says_nothing(play):
    class NoChoice(Count):
        action_space = spaces.Box(-1, 1, (2,))
        observation_space = spaces.Dict({"action_mask": spaces.MultiBinary(3), "seen": VECTOR})

        def reset(self, **options):
            return {"action_mask": np.ones(3, np.int8), "seen": super().reset(**options)[0]}, self.info()

        def info(self):
            return {"action_mask": np.ones(2)}

    assert only(play(NoChoice).reset()).masks == ()


@pytest.mark.parametrize("mask", [np.ones(4), 1, {"a": [1]}, "everything"])
def test_a_mask_that_cant_be_read_is_refused(mask, play):
    with pytest.raises(SimulationError):
        play(masked(mask)).reset()


def test_whatever_else_an_info_holds_does_no_harm(play):
    """Gymnasium's batches of infos want all copies' arrays to have one shape."""

    class Odd(Count):
        def info(self):
            self.told = getattr(self, "told", 0) + 1
            return {
                "path": np.zeros(self.told * int(100 * self.seen[2])),
                "x": None if self.told % 2 else 3,
                "f": print,
            }

    simulation = play(Odd)
    simulation.reset()
    assert len(answer(simulation)[1]) == 2


# Environment parameters.


def in_envs(simulation, name):
    return [getattr(env.unwrapped, name) for env in simulation._envs.envs]


def test_a_declared_attribute_is_set_from_the_next_episode_on(play):
    simulation = play(parameters=("gravity", "length"), arguments={})
    simulation.reset()
    simulation.set_parameter("gravity", 3.0)
    simulation.set_parameter("length", 1.9)
    answer(simulation)
    assert in_envs(simulation, "gravity") == [9.8, 9.8]
    simulation.reset()
    assert in_envs(simulation, "gravity") == [3.0, 3.0]
    assert in_envs(simulation, "length") == [2, 2]  # it is a whole number, and stays one


def test_numpys_numbers_are_parameters_too(play):
    simulation = play(parameters=("half",))
    simulation.set_parameter("half", 0.25)
    simulation.reset()
    assert in_envs(simulation, "half") == [0.25, 0.25]
    assert isinstance(in_envs(simulation, "half")[0], np.float32)


def test_a_parameter_that_is_set_before_the_first_reset_counts_for_it_in_every_copys_process(play):
    simulation = play("Pendulum-v1", parameters=("g",), mode="async")
    simulation.set_parameter("g", 0.0)
    simulation.reset()
    assert simulation._envs.get_attr("unwrapped")[0].g == 0


def test_a_parameter_begins_even_an_episode_that_began_by_itself_anew(play):
    simulation = play(arguments={"length": 1}, parameters=("gravity",))
    simulation.reset()
    answer(simulation)
    simulation.set_parameter("gravity", 1.0)
    assert only(simulation.reset()).observations[0][:, 0].tolist() == [3, 3]
    answer(simulation)
    simulation.set_parameter("gravity", 1.0)  # nothing new
    assert only(simulation.reset()).observations[0][:, 0].tolist() == [4, 4]


def test_an_argument_is_set_by_making_the_environment_anew_deterministically(play):
    def episodes():
        simulation = play(arguments={"length": 1}, seed=4)
        simulation.reset()
        seen = []
        for length in (2.0, 1.0, 1.0):
            simulation.set_parameter("length", length)
            seen.append(only(simulation.reset()).observations[0].tolist())
            assert in_envs(simulation, "length") == [length] * 2
            answer(simulation)
        return seen

    first = episodes()
    assert first == episodes()
    numbers = [row[2] for moment in first[:2] for row in moment]
    assert len(set(numbers)) == 4  # each episode and copy has random numbers of its own


def test_an_argument_that_changes_the_spaces_is_refused(play):
    class Sized(Count):
        def __init__(self, size=3):
            super().__init__()
            self.observation_space = spaces.Box(-1, 1, (size,))

        def reset(self, **options):
            super().reset(**options)
            return np.zeros(self.observation_space.shape, np.float32), {}

    simulation = play(Sized, arguments={"size": 3})
    simulation.reset()
    simulation.set_parameter("size", 4.0)
    with pytest.raises(
        SimulationError, match=r"With size = 4 the environment has other spaces than a trainer was told"
    ):
        simulation.reset()


def test_a_sampler_draws_for_every_copy_and_episode_the_same_each_time(play):
    def drawn():
        simulation = play(parameters=("gravity",), arguments={"length": 1})
        simulation.set_parameter("gravity", Uniform(7, 1.0, 2.0))
        simulation.reset()
        found = in_envs(simulation, "gravity")
        answer(simulation)
        return found + in_envs(simulation, "gravity")

    first = drawn()
    assert first == drawn()
    assert len(set(first)) == 4
    assert all(1 <= value <= 2 for value in first)


def test_a_wrapper_with_a_setting_of_its_own_gets_none_of_ours(play, monkeypatch):
    class Own(gymnasium.Wrapper):
        def __init__(self, env):
            super().__init__(env)
            self.settings = "mine"

    monkeypatch.setitem(sys.modules, "my_wrappers", types.SimpleNamespace(Own=Own))
    simulation = play(parameters=("gravity",), wrappers=("my_wrappers:Own",))
    simulation.set_parameter("gravity", 3.0)
    simulation.reset()
    assert in_envs(simulation, "gravity") == [3, 3]
    assert simulation._envs.get_attr("settings") == ("mine", "mine")


def test_a_parameter_that_is_not_declared_is_refused_with_the_nearest(play):
    with pytest.raises(
        ValueError, match="'gravty' is no environment parameter here: the nearest that is declared is grav"
    ):
        play(parameters=("gravity",)).set_parameter("gravty", 1.0)
    with pytest.raises(ValueError, match="none is declared; an attribute is declared with --parameters"):
        play().set_parameter("length", 1.0)


@pytest.mark.parametrize("name", ["nothing", "ends", "seen"])
def test_an_attribute_that_is_no_number_cant_be_declared(name, play):
    with pytest.raises(SimulationError, match=f"--parameters names '{name}', but Mine0-v0 has no such number"):
        play(parameters=(name,))


# Wrappers.


def test_wrappers_are_put_around_it_from_the_inmost_and_may_change_the_spaces(play):
    simulation = play(
        "FrozenLake-v1",
        wrappers=("gymnasium.wrappers:FlattenObservation", "my_wrappers:three_actions"),
    )
    assert [sensor.shape for sensor in simulation._behavior.sensors] == [(16,)]
    assert simulation._behavior.discrete_branches == (3,)
    assert only(simulation.reset()).observations[0].sum(axis=1).tolist() == [1, 1]


@pytest.fixture(autouse=True)
def my_wrappers(monkeypatch):
    def three_actions(env):
        return gymnasium.wrappers.TransformAction(env, lambda action: action, spaces.Discrete(3))

    monkeypatch.setitem(sys.modules, "my_wrappers", types.SimpleNamespace(three_actions=three_actions))


# Environments that fail.


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
def test_an_environment_that_raises_is_named_with_its_own_words_in_one_line(where, said, mode, play):
    with pytest.raises(SimulationError) as caught:
        run(play(failing(where, ValueError("no\n fuel")), mode=mode))
    assert str(caught.value) == f"Mine0-v0 {said} (ValueError: no fuel)."
    assert isinstance(caught.value.__cause__, ValueError)


def test_an_environment_that_would_end_the_process_has_failed(play):
    with pytest.raises(SimulationError, match=r"failed in a step \(SystemExit: 3\)"):
        run(play(failing("step", SystemExit(3))))


def test_a_stop_of_the_player_in_the_middle_of_a_step_is_no_failure_of_the_environment(play):
    from corridor_server.main import Stopped

    with pytest.raises(Stopped):
        run(play(failing("step", Stopped("Stopped by SIGTERM"))))


@pytest.mark.parametrize("at", ["step", "reset"])
def test_a_process_that_dies_is_a_failure_and_leaves_nothing_behind(at, play):
    class Dying(Count):
        def reset(self, **options):
            if at == "reset" and self.seen[0]:
                os.kill(os.getpid(), signal.SIGKILL)
            return super().reset(**options)

        def step(self, action):
            if at == "step" and self.seen[1] == 1:
                os.kill(os.getpid(), signal.SIGKILL)
            return super().step(action)

    simulation = play(Dying, mode="async")
    simulation.reset()
    answer(simulation)
    with pytest.raises(SimulationError, match=rf"failed in a {at} \(.*(its process ended|Connection|pipe)"):
        [answer(simulation) for _ in range(2)]
    simulation.close()
    for process in simulation._envs.processes:
        process.join(10)
        assert not process.is_alive()


def test_a_copys_process_is_no_fork_of_the_player_which_has_threads_and_a_socket(play):
    """A fork of it crashed now and then, and kept the trainer from hearing that the player was gone."""
    [process, _] = play(mode="async")._envs.processes
    assert type(process).__name__ == "ForkServerProcess"


def test_a_copy_at_work_does_not_keep_the_player_from_closing(play):
    class Hanging(Count):
        def step(self, action):
            signal.pause()

    simulation = play(Hanging, mode="async", num_areas=1)
    simulation.reset()
    simulation._envs.step_async(np.array([0]))
    simulation.close()
    assert not simulation._envs.processes[0].is_alive()


def test_an_environment_that_raises_when_it_is_closed_does_no_harm(play, caplog):
    class Unclosable(Count):
        def close(self):
            raise RuntimeError("never")

    simulation = play(Unclosable)
    simulation.close()
    assert "Mine0-v0 failed when it was closed (RuntimeError: never)." in caplog.text


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
def test_an_observation_that_is_none_of_the_space_is_refused(observation, said, at, play):
    with pytest.raises(SimulationError, match=said):
        run(play(given(observation, at=at)))


@pytest.mark.parametrize("reward", [np.nan, np.inf, -np.inf, 1e300, None])
def test_a_reward_that_is_no_number_is_named(reward, play):
    number = {1e300: "inf", None: "nan"}.get(reward, str(reward))
    with pytest.raises(SimulationError, match=f"The environment gave agent 0 a reward = {number}, but finite"):
        run(play(given(reward=reward)))


@pytest.mark.parametrize("reward", ["much", [1.0, 2.0], {}])
def test_a_reward_of_another_kind_is_a_failure(reward, play):
    with pytest.raises(SimulationError, match="failed in a step"):
        run(play(given(reward=reward)))


def test_lists_and_pythons_numbers_are_observations_too(play):
    simulation = play(given({"eye": [[0.5, 1], [True, 0]], "which": np.int8(2)}))
    simulation.reset()
    _, asking = answer(simulation)
    assert asking.observations[0][0].tolist() == [[0.5, 1], [1, 0]]
    assert asking.observations[1][0].tolist() == [0, 0, 1]


def test_checking_makes_it_once_in_this_process_and_closes_it(register):
    pids = []

    class Noted(Count):
        def __init__(self):
            super().__init__()
            pids.append(os.getpid())

        def close(self):
            pids.append("closed")

    GymnasiumEnvironment(register(Noted), mode="async").check()
    assert pids == [os.getpid(), "closed"]


def test_many_copies_are_as_many_agents(play):
    simulation = play(num_areas=500, arguments={"length": 1})
    simulation.reset()
    ended, asking = answer(simulation)
    assert ended.ids.tolist() == asking.ids.tolist() == list(range(500))
