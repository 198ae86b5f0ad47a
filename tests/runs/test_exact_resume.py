"""A run that was stopped and resumed is as one that was not, bit for bit, whatever its players are."""

import signal
import sys
from pathlib import Path

import pytest
from conftest import BIN

sys.path.insert(0, str(Path(__file__).parents[1] / "faults"))
from harness import Run, stop_with


@pytest.mark.slow
def test_two_players_and_samplers_resume_bit_for_bit_too(tmp_path, free_port):
    settings = tmp_path / "settings.yaml"
    settings.write_text(
        "environment_parameters:\n  opponent_speed:\n    sampler_type: gaussian\n"
        "    sampler_parameters: {mean: 1, st_dev: 0.3}\n"
    )
    options = ("--num-envs", 2, "--num-areas", 4, "--steps", 4_000, "--eval-episodes", 4, "--config", settings)
    whole, cut = (Run(tmp_path, name, free_port, *options) for name in ("whole", "cut"))
    assert whole.finish() == 0, whole.output
    assert stop_with(cut, signal.SIGINT, 1_000, 0.01) == 130
    assert cut.finish("--resume") == 0, cut.output
    cut.equals(whole)


@pytest.mark.slow
def test_the_papers_preset_resumes_bit_for_bit_too(tmp_path, free_port):
    options = ("--preset", "paper", "--steps", 1_000, "--eval-episodes", 1)
    whole, cut = (Run(tmp_path, name, free_port, *options) for name in ("whole", "cut"))
    assert whole.finish() == 0, whole.output
    assert stop_with(cut, signal.SIGTERM, 256, 0.01) == 130
    assert cut.finish("--resume") == 0, cut.output
    cut.equals(whole)


@pytest.mark.slow
def test_unitys_decision_timing_resumes_bit_for_bit_too(tmp_path, free_port):
    """An episode is an idle step and 64 decisions: the last one, and the RESET after it, end every rollout of 256."""
    player = tmp_path / "player"
    player.write_text(f'#!/bin/sh\nexec {BIN / "corridor-server"} --decision-timing unity "$@"\n')
    player.chmod(0o755)
    options = ("--env", player, "--env-param", "max_episode_steps=65", "failure_return=-1000")
    options += ("--preset", "paper", "--steps", 1_000, "--eval-episodes", 1)
    whole, cut = (Run(tmp_path, name, free_port, *options) for name in ("whole", "cut"))
    assert whole.finish() == 0, whole.output
    assert stop_with(cut, signal.SIGTERM, 256, 0.01) == 130
    assert cut.finish("--resume") == 0, cut.output
    cut.equals(whole)
    assert whole.summary()["episodes"] == 16
