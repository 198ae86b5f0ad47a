"""The corridor's parameters: defaults, refusals, files and the documented table."""

from pathlib import Path

import pytest

from corridor_server.corridor.corridor_config import CorridorConfig, parameter_table


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"agent_spead": 3}, "'agent_spead' is not a parameter of the corridor; did you mean 'agent_speed'?"),
        ({"agent_speed": -1}, "agent_speed is -1, but a number from 0 to 100 m/s was expected."),
        ({"agent_speed": "fast"}, "agent_speed is 'fast', but a number from 0 to 100 m/s was expected."),
        ({"agent_speed": float("nan")}, "agent_speed is nan, but a number from 0 to 100 m/s was expected."),
        ({"agent_speed": True}, "agent_speed is True, but a number"),
        ({"decision_period": 2.5}, "decision_period is 2.5, but a whole number from 1 to 100 steps was expected."),
        ({"agent_spawn_x": [3, 1]}, "agent_spawn_x is [3, 1], but two numbers [low, high]"),
        ({"agent_spawn_x": 3}, "agent_spawn_x is 3, but two numbers [low, high]"),
        ({"agent_radius": 6}, "agent_radius is 6, but the corridor is only 20 x 10 m"),
    ],
)
def test_a_value_that_is_not_accepted_says_what_was_expected(values, says):
    with pytest.raises(ValueError, match="is") as error:
        CorridorConfig.from_mapping(values)
    assert says in str(error.value)


@pytest.mark.parametrize("name", ["corridor.yaml", "corridor.json"])
def test_a_file_sets_parameters(tmp_path, name):
    text = {"corridor.yaml": "agent_speed: 3\nagent_spawn_x: [-9, -8]\n", "corridor.json": '{"agent_speed": 3}'}[name]
    path = tmp_path / name
    path.write_text(text)
    assert CorridorConfig.from_file(path).agent_speed == 3.0


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("agent_spead: 3", "did you mean 'agent_speed'?"),
        ("- 1\n- 2", "holds [1, 2], but names and values were expected"),
        ("a: [", "is not YAML"),
    ],
)
def test_a_broken_file_is_named(tmp_path, text, says):
    path = tmp_path / "corridor.yaml"
    path.write_text(text)
    with pytest.raises(ValueError, match="corridor.yaml") as error:
        CorridorConfig.from_file(path)
    assert says in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ValueError, match="nowhere.yaml can't be read"):
        CorridorConfig.from_file(tmp_path / "nowhere.yaml")


def test_the_documented_table_is_the_configs():
    document = Path(__file__).parents[2] / "docs" / "parameters.md"
    assert parameter_table() in document.read_text()
