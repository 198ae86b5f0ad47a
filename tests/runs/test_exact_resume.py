"""A run that was stopped and resumed is as one that was not, bit for bit, whatever its players are."""

import signal
import sys
from pathlib import Path

import pytest
from conftest import BIN

sys.path.insert(0, str(Path(__file__).parents[1] / "faults"))
from harness import Run, stop_with
from prepared_run import PreparedRun

PAPER = ("--preset", "paper", "--steps", 640, "--eval-episodes", 1)


def stopped_and_resumed(folder: Path, port: int, number: int, steps: int, *options: object) -> Run:
    """A run that a signal stops after so many steps, once it equals one that nothing stops."""
    whole, cut = (PreparedRun(folder, name, port, *options) for name in ("whole", "cut"))
    assert whole.finish() == 0, whole.output
    assert stop_with(cut, number, steps, 0.01) == 130
    assert cut.finish("--resume") == 0, cut.output
    cut.equals(whole)
    return cut


@pytest.mark.slow
def test_two_players_with_samplers(tmp_path, free_port):
    settings = tmp_path / "settings.yaml"
    settings.write_text(
        "environment_parameters:\n  opponent_speed:\n    sampler_type: gaussian\n"
        "    sampler_parameters: {mean: 1, st_dev: 0.3}\n"
    )
    players = ("--num-envs", 2, "--num-areas", 4, "--config", settings)
    learning = ("--preset", "threshold", "--steps", 1_000, "--eval-episodes", 2)
    stopped_and_resumed(tmp_path, free_port, signal.SIGINT, 500, *players, *learning)


@pytest.mark.slow
def test_the_papers_preset(tmp_path, free_port):
    stopped_and_resumed(tmp_path, free_port, signal.SIGTERM, 256, *PAPER)


@pytest.mark.slow
def test_unitys_decision_timing(tmp_path, free_port):
    """An episode is an idle step and 64 decisions: the last one, and the RESET after it, end every rollout of 256."""
    player = tmp_path / "player"
    player.write_text(f'#!/bin/sh\nexec {BIN / "corridor-server"} --decision-timing unity "$@"\n')
    player.chmod(0o755)
    episodes = ("--env-param", "max_episode_steps=65", "failure_return=-1000")
    run = stopped_and_resumed(tmp_path, free_port, signal.SIGTERM, 256, "--env", player, *episodes, *PAPER)
    assert run.summary()["episodes"] == 10


@pytest.mark.slow
def test_trpo_whose_actor_has_no_optimiser(tmp_path, free_port):
    learning = ("--algo", "trpo", "--num-areas", 4, "--steps", 2_048, "--eval-episodes", 1)
    stopped_and_resumed(tmp_path, free_port, signal.SIGTERM, 1_024, *learning)


@pytest.mark.slow
def test_a_curriculum_from_a_sampler_to_a_number(tmp_path, free_port):
    """The second lesson is there when the signal comes: a player that is new to the run never had the sampler."""
    settings = tmp_path / "settings.yaml"
    settings.write_text(
        "default_settings: {max_steps: 1536, hyperparameters: {buffer_size: 128, batch_size: 64}}\n"
        "environment_parameters:\n"
        "  goal_radius:\n"
        "    curriculum:\n"
        "      - {name: drawn, value: {sampler_type: uniform, sampler_parameters: {min_value: 2.0, max_value: 3.0}},\n"
        "         completion_criteria: {behavior: Corridor, measure: progress, threshold: 0.2, min_lesson_length: 1}}\n"
        "      - {name: said, value: 1.5}\n"
    )
    few = ("--num-areas", 4, "--eval-episodes", 1, "--env-param", "max_episode_steps=50")
    stopped_and_resumed(tmp_path, free_port, signal.SIGTERM, 768, settings, *few)
