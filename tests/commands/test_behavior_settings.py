"""A behavior's section of mlagents-learn's YAML: its names, its defaults, and what is refused."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from trainer.behavior_settings import (
    BehaviorSettings,
    CuriositySignal,
    NetworkSettings,
    PPOHyperparameters,
    RewardSignal,
    RewardSignals,
    RNDSignal,
    SACHyperparameters,
)
from trainer.errors import SettingError, TrainerError
from trainer.listed_behaviors import read_behaviors, settings_for


def test_the_defaults_are_those_of_mlagents():
    assert BehaviorSettings.from_mapping({}) == BehaviorSettings()
    assert BehaviorSettings().as_dict() == {
        "trainer_type": "ppo",
        "hyperparameters": {
            "batch_size": 1024,
            "buffer_size": 10240,
            "learning_rate": 3e-4,
            "learning_rate_schedule": "linear",
            "beta": 5e-3,
            "beta_schedule": "linear",
            "epsilon": 0.2,
            "epsilon_schedule": "linear",
            "lambd": 0.95,
            "num_epoch": 3,
            "shared_critic": False,
        },
        "network_settings": {
            "normalize": False,
            "hidden_units": 128,
            "num_layers": 2,
            "vis_encode_type": "simple",
            "goal_conditioning_type": "hyper",
            "deterministic": False,
        },
        "reward_signals": {"extrinsic": {"strength": 1.0, "gamma": 0.99}},
        "keep_checkpoints": 5,
        "checkpoint_interval": 500_000,
        "even_checkpoints": False,
        "max_steps": 500_000,
        "time_horizon": 64,
        "summary_freq": 50_000,
        "threaded": False,
    }
    assert (CuriositySignal().learning_rate, RNDSignal().learning_rate) == (3e-4, 1e-4)


def test_the_defaults_of_sac_are_its_own():
    assert BehaviorSettings.from_mapping({"trainer_type": "sac"}).hyperparameters.as_dict() == {
        "batch_size": 128,
        "buffer_size": 50_000,
        "learning_rate": 3e-4,
        "learning_rate_schedule": "constant",
        "buffer_init_steps": 0,
        "tau": 0.005,
        "steps_per_update": 1.0,
        "save_replay_buffer": False,
        "init_entcoef": 1.0,
        "reward_signal_steps_per_update": 1.0,
    }


def test_the_schedules_of_beta_and_epsilon_follow_the_learning_rates():
    read = PPOHyperparameters.from_mapping({"learning_rate_schedule": "constant", "epsilon_schedule": "linear"})
    assert (read.beta_schedule, read.epsilon_schedule) == ("constant", "linear")


def test_sacs_reward_signals_are_updated_as_often_as_its_policy():
    assert SACHyperparameters.from_mapping({"steps_per_update": 10}).reward_signal_steps_per_update == 10
    read = SACHyperparameters.from_mapping({"steps_per_update": 10, "reward_signal_steps_per_update": 5})
    assert read.reward_signal_steps_per_update == 5


def test_numbers_that_pyyaml_reads_as_texts_are_numbers():
    read = BehaviorSettings.from_mapping({"max_steps": "5e5", "hyperparameters": {"learning_rate": "3e-4"}})
    assert (read.max_steps, type(read.max_steps)) == (500_000, int)
    assert read.hyperparameters.learning_rate == 3e-4


def test_reward_signals_that_are_listed_are_all_that_there_are():
    signals = RewardSignals.from_mapping({"curiosity": {"strength": 0.02}})
    assert signals == RewardSignals(extrinsic=None, curiosity=CuriositySignal(strength=0.02))
    assert RewardSignals.from_mapping({"extrinsic": {}, "rnd": {"gamma": 0.9}}).rnd == RNDSignal(gamma=0.9)


def test_the_encoding_size_of_versions_before_is_the_networks_size():
    assert CuriositySignal.from_mapping({"encoding_size": 256}).network_settings == NetworkSettings(hidden_units=256)
    both = {"encoding_size": 256, "network_settings": {"hidden_units": 64}}
    with pytest.raises(SettingError, match="encoding_size is 256, but network_settings.hidden_units, .* is 64; take"):
        CuriositySignal.from_mapping(both)
    assert CuriositySignal.from_mapping({**both, "encoding_size": None}).network_settings.hidden_units == 64


def test_even_checkpoints_divide_the_run():
    read = BehaviorSettings.from_mapping({"even_checkpoints": True, "max_steps": 1000, "keep_checkpoints": 4})
    assert read.checkpoint_interval == 250
    assert BehaviorSettings(even_checkpoints=True, max_steps=3).checkpoint_interval == 1


def test_what_changes_nothing_or_asks_for_nothing_is_taken_and_left_out():
    """A file that mlagents-learn wrote has every name that it knows."""
    written = {
        "framework": "pytorch",
        "self_play": None,
        "behavioral_cloning": None,
        "init_path": None,
        "network_settings": {"memory": None},
        "reward_signals": {"extrinsic": {"network_settings": {"hidden_units": 128, "memory": None}}},
    }
    assert BehaviorSettings.from_mapping(written) == BehaviorSettings()


def test_our_own_name_is_written_only_where_it_says_something_else_than_mlagents():
    one = PPOHyperparameters(value_heads="one")
    assert one.as_dict()["value_heads"] == "one"
    assert PPOHyperparameters.from_mapping(one.as_dict()) == one
    assert "value_heads" not in PPOHyperparameters().as_dict()


BOTH = "a minibatch is drawn from the buffer; make batch_size at most buffer_size"


@pytest.mark.parametrize(
    ("values", "where", "says"),
    [
        ({"max_step": 5}, "max_step", "a behavior has no 'max_step'; the nearest name is max_steps."),
        ({"zzz": 5}, "zzz", "a behavior has no 'zzz'; known ones are trainer_type, hyperparameters, .*summary_freq."),
        ({3: 5}, "3", "a behavior has no 3; known ones are"),
        ({"batch_size": 5}, "batch_size", "a behavior has no batch_size, which stands under hyperparameters."),
        ({"normalize": True}, "normalize", "a behavior has no normalize, which stands under network_settings."),
        ({"trainer_type": "poca"}, "trainer_type", "trainer_type is 'poca', but one of ppo, sac was expected."),
        ({"trainer_type": []}, "trainer_type", r"trainer_type is \[\], but one of ppo, sac was expected."),
        ({"max_steps": 0}, "max_steps", "max_steps is 0, but a whole number from 1 up was expected."),
        ({"max_steps": "many"}, "max_steps", "max_steps is 'many', but a whole number from 1 up was expected."),
        ({"threaded": 3}, "threaded", "threaded is 3, but true or false was expected."),
        ({"self_play": {}}, "self_play", "has self_play, which is not supported: no team plays against its past"),
        (
            {"behavioral_cloning": {"demo_path": "x"}},
            "behavioral_cloning",
            "not supported: nothing is learned from dem",
        ),
        ({"hyperparameters": 5}, "hyperparameters", "hyperparameters is 5, but lines 'name: value' were expected."),
        ({"hyperparameters": {"tau": 1}}, "hyperparameters tau", "hyperparameters has no 'tau'; known ones are batch"),
        (
            {"trainer_type": "sac", "hyperparameters": {"beta": 1}},
            "hyperparameters beta",
            "hyperparameters has no 'beta'; ",
        ),
        (
            {"hyperparameters": {"learning_rate_schedule": "cosine"}},
            "hyperparameters learning_rate_schedule",
            "learning_rate_schedule is 'cosine', but one of constant, linear was expected.",
        ),
        (
            {"hyperparameters": {"buffer_size": 512}},
            "hyperparameters batch_size",
            f"is 1024, but .* is 512, and {BOTH}",
        ),
        (
            {"trainer_type": "sac", "hyperparameters": {"batch_size": 100_000}},
            "hyperparameters batch_size",
            f"is 100000, but buffer_size is 50000, and {BOTH}",
        ),
        ({"network_settings": {"hidden_units": 5000}}, "network_settings hidden_units", "from 1 to 4096 was expected"),
        (
            {"network_settings": {"memory": {"memory_size": 128}}},
            "network_settings memory",
            "network_settings has memory, which is not supported: there are no recurrent networks here; take memory",
        ),
        ({"reward_signals": {}}, "reward_signals", "reward_signals has no signal; give extrinsic, curiosity or rnd."),
        ({"reward_signals": {"curiosty": {}}}, "reward_signals curiosty", "the nearest name is curiosity"),
        ({"reward_signals": {"curiosity": None}}, "reward_signals curiosity", "curiosity is None, but lines"),
        ({"reward_signals": {"gail": {}}}, "reward_signals gail", "has gail, which is not supported: nothing is learn"),
        (
            {"reward_signals": {"curiosity": {"gamma": 2}}},
            "reward_signals curiosity gamma",
            "gamma is 2, but a number from 0 to 1 was expected.",
        ),
    ],
)
def test_what_cant_be_used_is_refused_in_one_sentence_that_knows_its_place(values, where, says):
    with pytest.raises(SettingError, match=says) as refused:
        BehaviorSettings.from_mapping(values)
    assert " ".join(map(str, refused.value.where)) == where
    assert str(refused.value).endswith(".")


def test_settings_of_another_trainer_type_are_refused_from_python_too():
    with pytest.raises(SettingError, match="trainer_type is sac, but hyperparameters are another's"):
        BehaviorSettings(trainer_type="sac")
    assert BehaviorSettings("sac", SACHyperparameters()).trainer_type == "sac"


def test_a_behavior_stands_over_the_default_settings():
    default = {"hyperparameters": {"beta": 0.1, "batch_size": 64}, "reward_signals": {"rnd": {}}, "max_steps": 10}
    behaviors, base = read_behaviors({"A": {"hyperparameters": {"beta": 0.2}}, "B": {}}, default)
    assert base == BehaviorSettings.from_mapping(default)
    assert behaviors["B"] == base
    assert behaviors["A"] == replace(base, hyperparameters=PPOHyperparameters(batch_size=64, beta=0.2))
    with_extrinsic, _ = read_behaviors({"A": {"reward_signals": {"extrinsic": {"gamma": 0.5}}}}, default)
    assert with_extrinsic["A"].reward_signals == RewardSignals(RewardSignal(gamma=0.5), rnd=RNDSignal())


def test_default_settings_of_another_trainer_type_are_refused():
    with pytest.raises(SettingError, match="trainer_type is 'sac', but default_settings has ppo") as refused:
        read_behaviors({"A": {"trainer_type": "sac"}}, {})
    assert refused.value.where == ("behaviors", "A", "trainer_type")


@pytest.mark.parametrize("name", ["", "Striker?team=0", 7])
def test_a_behaviors_name_is_a_text_without_a_team(name):
    with pytest.raises(SettingError, match="is no behavior's name; give it as a text, and without its team"):
        read_behaviors({name: {}}, None)


def test_a_behavior_has_its_own_settings_or_the_default_ones_or_mlagents():
    behaviors, default = read_behaviors({"Striker": {"max_steps": 7}}, {"max_steps": 8})
    assert settings_for("Striker?team=1", behaviors, default).max_steps == 7
    assert settings_for("Goalie", behaviors, default).max_steps == 8
    assert settings_for("Goalie", {}, None) == BehaviorSettings()
    with pytest.raises(
        TrainerError, match="has the behavior 'Strikr', .* nearest name is Striker.* add default_settin"
    ):
        settings_for("Strikr", behaviors, None)


KNOWN = (BehaviorSettings(), PPOHyperparameters(), SACHyperparameters(), CuriositySignal(), NetworkSettings())
OTHERS = ["curiosity", "rnd", "extrinsic", "gail", "memory", "encoding_size", "threaded", "self_play", "linear"]
NAMES = st.sampled_from([*(name for settings in KNOWN for name in settings.as_dict()), *OTHERS])
ANY = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | NAMES,
    lambda inner: st.lists(inner, max_size=2) | st.dictionaries(NAMES | st.text(max_size=3), inner, max_size=4),
    max_leaves=12,
)


@given(ANY)
def test_any_mapping_is_taken_or_refused_in_one_sentence(values):
    said = ""
    try:
        settings = BehaviorSettings.from_mapping(values)
    except SettingError as error:
        said = str(error)
    assert said.count("\n") == 0
    assert said.endswith(".") or BehaviorSettings.from_mapping(settings.as_dict()) == settings
