"""What is installed, and what a user sees of it."""

import os
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest
from conftest import BIN

ROOT = Path(__file__).parents[1]
WITHOUT = "import sys; sys.modules[{module!r}] = None; from trainer.main import main; sys.exit(main())"


@pytest.mark.parametrize("module", ["psutil", "tyro", "torch"])
def test_the_command_without_the_trainers_extra_says_what_to_install(module, tmp_path):
    program = [sys.executable, "-c", WITHOUT.format(module=module), "train", "--run-id", "r"]
    run = subprocess.run(program, capture_output=True, text=True, cwd=tmp_path, timeout=120)
    assert run.returncode == 1
    assert run.stderr == (
        f"error: corridor needs {module}, which is not installed; run pip install 'curious-corridor[trainer]'.\n"
    )


@pytest.mark.parametrize("command", ["corridor", "corridor-server"])
def test_a_command_says_its_version(command):
    run = subprocess.run([str(BIN / command), "--version"], capture_output=True, text=True, timeout=120)
    assert (run.returncode, run.stdout.split()[0]) == (0, command)
    assert run.stdout.split()[1][0].isdigit()


def test_the_source_distribution_has_what_runs_and_no_tests_that_could_not(tmp_path):
    tracked = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for name in filter(None, tracked.split("\0")):
        if not name.startswith(("docs/", "tests/golden/")):
            (tmp_path / "source" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, tmp_path / "source" / name)
    build = "import sys; from setuptools import build_meta; build_meta.build_sdist(sys.argv[1])"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    program = [sys.executable, "-c", build, tmp_path]
    subprocess.run(program, cwd=tmp_path / "source", env=environment, check=True, capture_output=True, timeout=120)
    with tarfile.open(next(tmp_path.glob("*.tar.gz"))) as file:
        names = {name.partition("/")[2] for name in file.getnames()}
    assert {"trainer/viewer/page/page.html", "corridor_server/protocol/messages.binpb", "LICENSE"} <= names
    assert [name for name in names if name.startswith("tests")] == []
