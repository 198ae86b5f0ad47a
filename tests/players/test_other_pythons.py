"""A current Python beyond the one at hand: import, handshake and 1,000 steps, in a fresh environment."""

import subprocess
import sys
from pathlib import Path

import pytest
from conftest import interpreter

PIP = [sys.executable, "-m", "pip"]
ROOT = Path(__file__).parents[2]
OTHERS = [each for each in ("3.11", "3.12", "3.13") if each != f"3.{sys.version_info.minor}"]

THOUSAND_STEPS = """
import sys
import trainer
from mlagents_envs.environment import UnityEnvironment
from google.protobuf.internal import api_implementation
assert api_implementation.Type() == "upb"
from trainer.players.gym_wrapper import UnityToGymWrapper
env = UnityToGymWrapper(UnityEnvironment(sys.argv[1], base_port=int(sys.argv[2]), seed=1, no_graphics=True))
env.reset()
for _ in range(1000):
    _, _, terminated, truncated, _ = env.step(env.action_space.sample())
    if terminated or truncated:
        env.reset()
env.close()
print("done")
"""


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What ``pip install .`` builds and installs, whichever Python it is for."""
    folder = tmp_path_factory.mktemp("wheel")
    subprocess.run([*PIP, "wheel", "--quiet", "--no-deps", "--wheel-dir", folder, ROOT], check=True, cwd=folder)
    (built,) = folder.glob("*-py3-none-any.whl")
    return built


@pytest.mark.slow
@pytest.mark.parametrize("version", OTHERS)
def test_the_client_runs_on_python(version, wheel, tmp_path, free_port):
    """Installs the wheel's ``[client]`` (no torch) and steps the player with the unmodified mlagents-envs."""
    python = interpreter(version)
    if python is None:
        pytest.skip(f"no Python {version} on this machine")
    subprocess.run([python, "-m", "venv", "--without-pip", tmp_path / "venv"], check=True)
    bin_folder = tmp_path / "venv" / "bin"
    install = ["install", "--quiet", "--no-compile", "--constraint", ROOT / "constraints.txt", f"{wheel}[client]"]
    subprocess.run([*PIP, "--python", bin_folder / "python", *install], check=True, cwd=tmp_path)
    program = [bin_folder / "python", "-c", THOUSAND_STEPS, bin_folder / "corridor-server", str(free_port)]
    run = subprocess.run(program, capture_output=True, text=True, cwd=tmp_path, timeout=120)
    assert run.stdout.endswith("done\n"), run.stderr
