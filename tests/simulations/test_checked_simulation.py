"""A simulation of somebody's own (the hallway of docs/player.md) that raises, or gives what can't be used."""

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import BIN
from mlagents_envs.exception import UnityCommunicatorStoppedException, UnityEnvironmentException

from corridor_server.protocol.agents import ActionBatch, Agents, Behavior, Sensor
from corridor_server.simulations.checked_simulation import CheckedSimulation
from corridor_server.simulations.simulation import NotRestored, Simulation, SimulationError, Stopped
from trainer.players.opening import open_environment

[PROGRAM] = re.findall(r"```python\n(.*?)```", (Path(__file__).parents[2] / "docs/player.md").read_text(), re.DOTALL)
page = {"__name__": "hallway"}
exec(PROGRAM, page)
Hallway, HALLWAY = page["Hallway"], page["HALLWAY"]
NAME = HALLWAY.name


def gives(reset=None, step=None, **attributes):
    """The hallway, of which a reset's moment, or all that a step told, goes through a function."""

    class Mine(Hallway):
        def reset(self):
            moment = super().reset()
            return moment if reset is None else reset(moment)

        def step(self, actions):
            told = super().step(actions)
            return told if step is None else step(*told)

    for name, value in attributes.items():
        setattr(Mine, name, value)
    return Mine


def told_with(**columns):
    """The hallway whose steps' agents have other columns."""
    return gives(step=lambda moment, statistics: ({NAME: replace(moment[NAME], **columns)}, statistics))


def declares(**parts):
    return gives(behaviors={NAME: replace(HALLWAY, **parts)})


def raises(error):
    def fail(*given):
        raise error

    return fail


def play(kind):
    simulation = CheckedSimulation(lambda: kind(1, 3))
    simulation.reset()
    return simulation.step({NAME: ActionBatch(np.zeros((3, 0), np.float32), np.ones((3, 1), np.int32))})


def array(*rows, dtype=np.float32):
    return np.array(rows, dtype)


SEEN = np.zeros((3, 2), np.float32)
GAVE = "The simulation gave "
MISTAKES = {
    "reset raises": (
        gives(reset=raises(RuntimeError("no\nfuel"))),
        "The simulation failed in a reset (RuntimeError: no",
    ),
    "step raises": (gives(step=raises(KeyError("foo"))), "The simulation failed in a step (KeyError: 'foo')."),
    "step raises what options do": (
        gives(step=raises(ValueError("no fuel"))),
        "failed in a step (ValueError: no fuel)",
    ),
    "step ends the process": (gives(step=raises(SystemExit(3))), "The simulation failed in a step (SystemExit: 3)."),
    "none is made": (lambda *_: None, "make_simulation gave None, but a Simulation was expected."),
    "an abstract one": (lambda *_: Simulation(), "The simulation can't be made (TypeError: Can't instantiate"),
    "a constructor raises": (raises(OSError("no fuel")), "The simulation can't be made (OSError: no fuel)."),
    "no behaviors": (gives(behaviors=None), "doesn't say what its behaviors are (AttributeError: "),
    "no Behavior": (gives(behaviors={NAME: 3}), "behaviors has 3 as 'Hallway?team=0', but a Behavior was expected."),
    "another key": (
        gives(behaviors={"Hall": HALLWAY}),
        "has the Behavior 'Hallway?team=0' as 'Hall', but its own name",
    ),
    "sensors in a list": (declares(sensors=list(HALLWAY.sensors)), "but a tuple of at least one Sensor was expected."),
    "no sensors": (declares(sensors=()), "has sensors = (), but a tuple of at least one Sensor was expected."),
    "a float's shape": (
        declares(sensors=(Sensor.of("x", (2.0,)),)),
        "Sensor x of Hallway?team=0 has shape = (2.0,), but",
    ),
    "a number of branches": (declares(discrete_branches=2), "has discrete_branches = 2, but a tuple of each branch's"),
    "nothing to do": (declares(discrete_branches=()), "has continuous_actions = 0 and discrete_branches = (), but"),
    "a reset of None": (
        gives(reset=lambda moment: None),
        "The simulation's reset gave None, but a moment was expected",
    ),
    "a reset of nobody": (
        gives(reset=lambda moment: {}),
        "reset gave 0 agents that ask and 0 that ended, but at least",
    ),
    "a step of None": (
        gives(step=lambda *told: None),
        "The simulation's step gave None, but a tuple of its moment and",
    ),
    "no statistics": (
        gives(step=lambda moment, _: moment),
        "step gave a dict, but a tuple of its moment and its stati",
    ),
    "an empty moment": (gives(step=lambda *told: ({}, {})), "step gave a moment without agents, but one in which"),
    "no Agents": (gives(step=lambda *told: ({NAME: [1]}, {})), "gave a list of 1 for Hallway?team=0, but Agents were"),
    "an undeclared behavior": (
        gives(step=lambda moment, _: ({"Foo?team=0": moment[NAME]}, {})),
        "step gave agents of 'Foo?team=0', but its behaviors are Hallway?team=0; declare it there.",
    ),
    "a statistic's number": (
        gives(step=lambda moment, _: (moment, {"x": 1.0})),
        "gave the statistic 'x' = 1.0, but a name",
    ),
    "a statistic's text": (
        gives(step=lambda moment, _: (moment, {"x": ["y"]})),
        "the statistic 'x' = ['y'], but a name",
    ),
    "a statistic's NaN": (gives(step=lambda moment, _: (moment, {"x": [np.nan]})), "statistic x = [nan], but finite"),
    "uneven statistics": (
        gives(step=lambda moment, _: (moment, {"x": [1.0], "y": [1.0, 2.0]})),
        "step gave 2 numbers of the statistic y, but 1 of x; one for each episode that ended was expected of all.",
    ),
    "ids twice": (
        told_with(ids=array(1, 2, 1, dtype=np.int32)),
        "agent 1 of Hallway?team=0 twice as one that asks, but",
    ),
    "ids below 0": (told_with(ids=array(0, 1, -5, dtype=np.int64)), GAVE + "an id of Hallway?team=0 = -5, but 0 to"),
    "ids in a list": (told_with(ids=[0, 1, 2]), GAVE + "ids of Hallway?team=0 as a list of 3, but an array of (n,)"),
    "ids that wrap": (
        gives(reset=lambda moment: {NAME: Agents.that_ask([2**32 + 1], (SEEN[:1],), [0])}),
        f"failed in a reset (ValueError: an agent's id is {2**32 + 1}, but a whole number from 0 to 2147483647 was",
    ),
    "a reward of NaN": (
        told_with(rewards=array(0, np.nan, 0)),
        "gave agent 1 of Hallway?team=0 a reward = nan, but finite",
    ),
    "too few rewards": (told_with(rewards=array(0)), GAVE + "rewards of Hallway?team=0 of shape (1,), but (3,) was"),
    "rewards of text": (told_with(rewards=np.array(["1"] * 3)), GAVE + "rewards of Hallway?team=0 of <U1, but numbers"),
    "a group below 0": (
        told_with(group_ids=array(0, -3, 0, dtype=np.int32)),
        "a group id of Hallway?team=0 = -3, but 0",
    ),
    "a group's NaN": (
        told_with(group_rewards=array(0, 0, np.nan)),
        "agent 2 of Hallway?team=0 a group reward = nan, but",
    ),
    "observations in a list": (
        told_with(observations=(SEEN.tolist(),)),
        GAVE + "observation place and door of Hallway?team=0 as a list of 3, but a NumPy array was expected.",
    ),
    "no tuple": (told_with(observations=SEEN), GAVE + "observations of Hallway?team=0 as a ndarray, but a tuple of an"),
    "a narrow observation": (told_with(observations=(SEEN[:, :1],)), "of shape (3, 1), but (3, 2) was expected: a row"),
    "objects observed": (told_with(observations=(SEEN.astype(object),)), "of object, but numbers were expected."),
    "NaN observed": (
        told_with(observations=(array([0, 0], [0, np.nan], [0, 0]),)),
        GAVE + "agent 1 of Hallway?team=0 observation place and door[1] = nan, but finite numbers were expected.",
    ),
    "too much observed": (
        told_with(observations=(SEEN.astype(np.float64) - 1e300,)),
        "[0] = -1e+300, but numbers that float32 can hold",
    ),
    "nothing allowed": (
        told_with(masks=(array([0, 0], [1, 0], [1, 1], dtype=np.bool_),)),
        GAVE
        + "agent 2 of Hallway?team=0 a mask that forbids all choices of branch 0, but at least one that is allowed",
    ),
    "a wide mask": (told_with(masks=(np.zeros((3, 3), np.bool_),)), "masks[0] of Hallway?team=0 of shape (3, 3), but"),
    "a mask of numbers": (
        told_with(masks=(np.zeros((3, 2), np.int64),)),
        "of int64, but bool, True for a choice that is",
    ),
    "two masks": (told_with(masks=(np.zeros((3, 2), np.bool_),) * 2), "masks of Hallway?team=0 as a tuple of 2, but a"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_in_a_simulation_of_ones_own_is_one_sentence(mistake):
    kind, said = MISTAKES[mistake]
    with pytest.raises(SimulationError) as caught:
        play(kind)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(caught.value).endswith(".")


def test_what_the_page_gives_arrives_as_it_is_and_other_numbers_in_the_type_that_they_travel_in():
    moment, statistics = play(told_with(observations=(SEEN.astype(np.int64) + 2,), ids=np.array([4, 0, 7])))
    assert statistics == {}
    [agents] = moment.values()
    assert agents.observations[0].dtype == np.float32
    assert agents.observations[0].tolist() == [[2, 2]] * 3
    assert agents.ids.dtype == np.int32
    assert agents.ids.tolist() == [4, 0, 7]


def test_agents_that_ended_may_have_all_choices_forbidden_and_ask_in_the_same_moment():
    forbidden = array([1, 1], [1, 1], [1, 1], [0, 1], dtype=np.bool_)
    ended = Agents.that_ended([0, 1, 2], (SEEN,), np.zeros(3), np.zeros(3))
    agents = replace(ended.then(Agents.that_ask([1], (SEEN[:1],), [0])), masks=(forbidden,))
    moment, _ = play(gives(step=lambda *told: ({NAME: agents}, {})))
    assert moment[NAME].deciding.ids.tolist() == [1]


def test_a_behavior_may_come_later_but_stays_what_it_was():
    made = Hallway(1, 1)
    simulation = CheckedSimulation(lambda: made)
    made.behaviors = {NAME: HALLWAY, "Other?team=0": replace(HALLWAY, name="Other?team=0")}
    simulation.reset()
    assert list(simulation.behaviors) == [NAME, "Other?team=0"]
    made.behaviors = {NAME: Behavior(NAME, HALLWAY.sensors, 3)}
    with pytest.raises(SimulationError, match="is another one than before, but a trainer is told of each only once"):
        simulation.reset()


def test_what_a_simulation_may_refuse_is_no_failure_and_a_stop_neither():
    simulation = CheckedSimulation(lambda: gives(restore=raises(NotRestored("so")))(1, 1))
    with pytest.raises(ValueError, match="has no environment parameters"):
        simulation.set_parameter("x", 1.0)
    with pytest.raises(NotRestored, match="so"):
        simulation.restore(np.zeros(1, [("x", "i4")]))
    with pytest.raises(SimulationError, match=r"failed when x was set \(TypeError: so\)"):
        CheckedSimulation(lambda: gives(set_parameter=raises(TypeError("so")))(1, 1)).set_parameter("x", 1.0)
    with pytest.raises(Stopped):
        play(gives(step=raises(Stopped())))


def test_one_that_cant_be_closed_or_saved_is_named(caplog):
    simulation = CheckedSimulation(lambda: gives(close=raises(RuntimeError("never")), snapshot=lambda self: [1])(1, 1))
    simulation.close()
    assert "The simulation failed when it was closed (RuntimeError: never)." in caplog.text
    with pytest.raises(SimulationError, match=r"snapshot gave \[1\], but an array of rows"):
        simulation.snapshot()


def test_the_trainer_is_told_and_the_log_ends_with_the_traceback_and_the_sentence(tmp_path, free_port, monkeypatch):
    monkeypatch.setenv("PATH", f"{BIN}{os.pathsep}{os.environ['PATH']}")  # whose Python the file asks for
    file = tmp_path / "hallway.py"
    file.write_text(PROGRAM.replace("self.steps += 1", "raise ValueError('no fuel')"))
    file.chmod(0o755)
    environment = open_environment(
        str(file), seed=1, num_areas=1, port=free_port, timeout_wait=60, log_folder=tmp_path, env_args=[]
    )
    try:
        environment.reset()
        with pytest.raises((UnityCommunicatorStoppedException, UnityEnvironmentException)):
            environment.step()
        assert environment._process.wait(20) == 1
    finally:
        environment.close()
    *before, last = (tmp_path / "Player-0.log").read_text().splitlines()
    assert last.endswith(" ERROR The simulation failed in a step (ValueError: no fuel).")
    assert any("hallway.py" in line for line in before)
    assert before[-1] == "ValueError: no fuel"
