"""The C# that docs/unity.md gives to a scene's author, compiled, and held against the contract.

Unity is not there: ``unity/Scene.cs`` stands in for the classes that the agent uses, and the stand-in for its runtime
speaks.
"""

import os
import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import pytest
from prepared import Prepared

from trainer.conformance import Actions, Conformance, CorridorContract, Episodes, Observations, Reset
from trainer.conformance.checker import Result, check

ROOT = Path(__file__).parents[2]
UNITY = ROOT / "tests" / "unity"
# How the build speaks and ends is no matter of the agent's: test_conformance_of_unity holds it to all topics.
OF_THE_AGENT = [Episodes, Observations, Actions, Reset, CorridorContract]

pytestmark = pytest.mark.skipif(shutil.which("mcs") is None, reason="Mono's C# compiler (mono-mcs) is not installed")


def build(folder: Path, agent: str) -> Path:
    """The scene whose agent is the given C#."""
    (folder / "CorridorAgent.cs").write_text(agent)
    sources = (folder / "CorridorAgent.cs", UNITY / "Scene.cs")
    subprocess.run(["mcs", "-warnaserror+", f"-out:{folder}/scene.exe", *sources], check=True)
    return folder / "scene.exe"


def failed(scene: Path, topics: Sequence[type[Conformance]]) -> list[str]:
    """The sentences that do not hold for the build with such a scene."""
    found: list[Result] = []

    def start(port: int, *arguments: str) -> Prepared:
        own = ("--spec", "scene", "--scene", f"mono {scene}", "-logFile", os.devnull)
        return Prepared([UNITY / "Build.x86_64", "--mlagents-port", port, *own, *arguments])

    check(topics, start, found.append)
    assert any(each.verdict == "pass" for each in found)
    return [f"{each.sentence}: {each.detail}" for each in found if each.verdict == "fail"]


@pytest.fixture(scope="module")
def agent() -> str:
    found = re.search(r"```csharp\n(.*?)```", (ROOT / "docs" / "unity.md").read_text(), re.DOTALL)
    assert found is not None
    return found[1]


@pytest.mark.slow
def test_the_agent_in_the_docs_keeps_the_contract(tmp_path, agent):
    assert failed(build(tmp_path, agent), OF_THE_AGENT) == []


@pytest.mark.slow
def test_an_agent_that_pays_otherwise_is_told_in_which_line(tmp_path, agent):
    stingy = agent.replace("AddReward(-failurePenalty);", "AddReward(-0.5f * failurePenalty);")
    assert stingy != agent
    (line,) = failed(build(tmp_path, stingy), [CorridorContract])
    assert line.startswith("a failed episode pays the penalty")
