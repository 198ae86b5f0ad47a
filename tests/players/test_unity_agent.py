"""The C# that docs/unity.md gives to a scene's author, compiled, and held against the contract.

Unity is not there: ``unity/Scene.cs`` stands in for the classes that the agent uses, and the stand-in for its runtime
speaks.
"""

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
from conftest import BIN

ROOT = Path(__file__).parents[2]
UNITY = ROOT / "tests" / "unity"

pytestmark = pytest.mark.skipif(shutil.which("mcs") is None, reason="Mono's C# compiler (mono-mcs) is not installed")


def build(folder: Path, agent: str) -> Path:
    """A player whose agent is the given C#."""
    (folder / "CorridorAgent.cs").write_text(agent)
    sources = (folder / "CorridorAgent.cs", UNITY / "Scene.cs")
    subprocess.run(["mcs", "-warnaserror+", f"-out:{folder}/scene.exe", *sources], check=True)
    player = folder / "Corridor.x86_64"
    options = ("--spec", "scene", "--scene", f"mono {folder}/scene.exe")
    command = shlex.join([str(BIN / "python"), str(UNITY / "Build.x86_64"), *options])
    player.write_text(f'#!/bin/sh\nexec {command} "$@"\n')
    player.chmod(0o755)
    return player


def check(player: Path) -> subprocess.CompletedProcess[str]:
    command = [BIN / "corridor", "check", "--env", player]
    return subprocess.run(command, capture_output=True, text=True, timeout=300)


@pytest.fixture(scope="module")
def agent() -> str:
    found = re.search(r"```csharp\n(.*?)```", (ROOT / "docs" / "unity.md").read_text(), re.DOTALL)
    assert found is not None
    return found[1]


@pytest.mark.slow
def test_the_agent_in_the_docs_keeps_the_contract(tmp_path, agent):
    done = check(build(tmp_path, agent))
    assert done.returncode == 0, done.stdout
    assert "0 fail" in done.stdout


@pytest.mark.slow
def test_an_agent_that_pays_otherwise_is_told_in_which_line(tmp_path, agent):
    stingy = agent.replace("AddReward(-failurePenalty);", "AddReward(-0.5f * failurePenalty);")
    assert stingy != agent
    done = check(build(tmp_path, stingy))
    assert done.returncode == 1
    failed = re.findall(r"│ fail │ (.*?) *│", done.stdout)
    assert failed == ["a failed episode pays the penalty"]
