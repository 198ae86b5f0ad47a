"""Our player under TorchRL's UnityMLAgentsEnv, which takes agents for what Unity's are: there from first to last."""

import json
import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from conftest import BIN

CLIENT = Path(__file__).with_name("torchrl_client.py")
ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def torchrl_python() -> str:
    """An interpreter with TorchRL and what our client needs: ``TORCHRL_PYTHON``, or this one."""
    if given := os.environ.get("TORCHRL_PYTHON"):
        return given
    if find_spec("torchrl") is None:
        pytest.skip("TorchRL is not installed here, and TORCHRL_PYTHON names no interpreter that has it")
    return sys.executable


PLAYED = {
    "the corridor": (["--decision-timing", "together"], {"group_0": 3}, 3),
    "the corridor in Unity's timing": (["--decision-timing", "unity"], {"group_0": 3}, 3),
    "groups": (["--pettingzoo", "mpe2.simple_spread_v3", "--group"], {"group_1": 3, "group_2": 3, "group_3": 3}, 9),
}


@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "groups", "agents"), PLAYED.values(), ids=PLAYED)
def test_torchrls_own_check_passes_and_it_plays_on_over_many_ends(torchrl_python, free_port, arguments, groups, agents):
    command = [torchrl_python, str(CLIENT), str(BIN / "corridor-server"), str(free_port), *arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    run = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)
    assert run.returncode == 0, run.stderr
    outcome = json.loads(run.stdout.splitlines()[-1])
    assert outcome["check_env_specs"] == "passed"
    assert (outcome["steps"], outcome["finite"]) == (1000, True)
    assert outcome["groups"] == groups
    assert sorted(outcome["ends"]) == [f"agent_{number}" for number in range(agents)]
    assert all(count > 10 for count in outcome["ends"].values())
