"""Lessons of environment parameters: when one is over, by hand, as mlagents 1.1.0 has it."""

import json
import math
import sys
from pathlib import Path

import pytest
import yaml

sys.path.insert(0, str(Path(__file__).parent))
from yaml_files import WALL_JUMP

from trainer.curriculum import Curricula
from trainer.errors import TrainerError


def lessons(*values, **criteria):
    """A curriculum whose every lesson but the last has the same criteria."""
    criteria = {"behavior": "A", **criteria}
    listed = [{"name": f"L{value}", "value": value, "completion_criteria": criteria} for value in values]
    del listed[-1]["completion_criteria"]
    return {"curriculum": listed}


def test_the_first_lessons_values_come_first_in_the_order_of_the_file():
    parameters = yaml.safe_load(WALL_JUMP)["environment_parameters"]
    curricula = Curricula({"gravity": -9.8, **parameters})
    height = {"sampler_type": "uniform", "sampler_parameters": {"min_value": 0.0, "max_value": 4.0}}
    assert list(curricula.values().items()) == [
        ("gravity", -9.8),
        ("big_wall_height", height),
        ("small_wall_height", 1.5),
    ]
    assert curricula.numbers == {"gravity": 0, "big_wall_height": 0, "small_wall_height": 0}


def test_progress_beyond_the_threshold_is_a_lessons_end():
    curricula = Curricula({"a": lessons(1, 2, 3, measure="progress", threshold=0.5)})
    assert curricula.update("A", 0.5, []) == (False, False)
    assert curricula.update("A", 0.51, []) == (True, False)
    assert curricula.values() == {"a": 2}
    assert curricula.update("A", 0.51, []) == (True, False), "one lesson at a time, though the next is over too"
    assert curricula.update("A", 1.0, []) == (False, False), "the last one has no end"
    assert curricula.values() == {"a": 3}


def test_a_reward_is_smoothed_from_0_with_three_quarters_of_the_new():
    curricula = Curricula({"a": lessons(1, 2, threshold=0.9)})
    assert curricula.update("A", 0, [1.0]) == (False, False)  # 0.75
    assert curricula.state_dict()["smoothed"] == {"a": 0.75}
    assert curricula.update("A", 0, [1.0, 0.8]) == (False, False)  # 0.25 * 0.75 + 0.75 * 0.9
    assert curricula.state_dict()["smoothed"] == {"a": pytest.approx(0.8625)}
    assert curricula.update("A", 0, [1.0]) == (True, False)  # 0.965625


def test_without_smoothing_the_mean_counts_as_it_is():
    curricula = Curricula({"a": lessons(1, 2, threshold=0.9, signal_smoothing=False)})
    assert curricula.update("A", 0, [0.8, 1.0]) == (False, False)
    assert curricula.update("A", 0, [0.9, 1.0]) == (True, False)


@pytest.mark.parametrize("measure", ["reward", "progress"])
def test_a_lesson_has_its_episodes(measure):
    curricula = Curricula({"a": lessons(1, 2, min_lesson_length=3, measure=measure, threshold=0.5)})
    assert curricula.update("A", 1.0, [9.0, 9.0]) == (False, False)
    assert curricula.state_dict()["smoothed"] == {"a": 0.0}
    assert curricula.update("A", 1.0, [9.0, 9.0, 9.0]) == (True, False)


@pytest.mark.parametrize("rewards", [[], [1.0, math.nan]])
def test_no_reward_ends_no_lesson(rewards):
    curricula = Curricula({"a": lessons(1, 2, threshold=-5.0)})
    assert curricula.update("A", 1.0, rewards) == (False, False)
    assert curricula.state_dict()["smoothed"] == {"a": 0.0}


def test_a_reset_is_asked_for_by_the_lesson_that_ends():
    curricula = Curricula({"a": lessons(1, 2, require_reset=True), "b": lessons(1, 2)})
    assert curricula.update("A", 0, [1.0]) == (True, True)
    assert Curricula({"b": lessons(1, 2)}).update("A", 0, [1.0]) == (True, False)


def test_each_behavior_moves_its_own_lessons():
    curricula = Curricula({"a": lessons(1, 2), "b": lessons(1, 2, behavior="B")})
    curricula.update("B", 0, [1.0])
    assert curricula.values() == {"a": 1, "b": 2}


def test_as_many_episodes_are_looked_at_as_the_longest_lesson_has():
    curricula = Curricula({"a": lessons(1, 2, min_lesson_length=30), "b": lessons(1, 2, min_lesson_length=20)})
    assert (curricula.episodes("A"), curricula.episodes("B")) == (30, 1)


def test_a_resumed_run_goes_on_in_mid_lesson():
    curricula = Curricula({"a": lessons(1, 2, 3, threshold=0.9), "g": 5})
    curricula.update("A", 0, [2.0])
    curricula.update("A", 0, [0.2])
    again = Curricula({"a": lessons(1, 2, 3, threshold=0.9), "g": 5})
    again.load_state_dict(json.loads(json.dumps(curricula.state_dict())))
    assert again.values() == {"a": 2, "g": 5}
    assert again.state_dict() == curricula.state_dict()


@pytest.mark.parametrize(
    ("state", "says"),
    [
        ({}, "The checkpoint's lessons are of other environment parameters"),
        ({"lessons": {"b": 0}, "smoothed": {"b": 0}}, "of other environment parameters"),
        ({"lessons": {"a": 2}, "smoothed": {"a": 0}}, "is in lesson 2 of a, but there are 2, counted from 0; train"),
        ({"lessons": {"a": 0}, "smoothed": {"a": "x"}}, "is in lesson 0 of a, "),
    ],
)
def test_a_state_of_other_lessons_is_refused(state, says):
    curricula = Curricula({"a": lessons(1, 2)})
    with pytest.raises(TrainerError, match=says):
        curricula.load_state_dict(state)
    assert curricula.numbers == {"a": 0}


def test_criteria_of_a_last_lesson_count_for_nothing_as_in_mlagents():
    last = {"name": "L", "value": 1, "completion_criteria": {"behavior": "Gone"}}
    curricula = Curricula({"a": {"curriculum": [last]}})
    curricula.check_behaviors(["A"])
    assert curricula.update("Gone", 1.0, [1.0]) == (False, False)
