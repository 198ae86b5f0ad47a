"""What the environment says to other programs breaks no command."""

import os
import subprocess
from pathlib import Path

import pytest
from conftest import BIN, unused_port

PROXY = "http://127.0.0.1:9"  # nobody is there
HOSTILE = {
    "MPLBACKEND": "module://matplotlib_inline.backend_inline",  # Jupyter's, which is not installed here
    "MATPLOTLIBRC": "/proc/none",
    "HOME": "/proc/none",
    "XDG_CACHE_HOME": str(Path.home() / ".cache"),  # where matplotlib's list of fonts is, or it makes one each time
    "TMPDIR": "/proc/none",
    **dict.fromkeys(("http_proxy", "https_proxy", "grpc_proxy", "all_proxy", "HTTP_PROXY", "HTTPS_PROXY"), PROXY),
    "COLUMNS": "0",
    "LINES": "many",
    "TERM": "dumb",
    "FORCE_COLOR": "perhaps",
    "LANG": "C",
    "LC_ALL": "C",
    "PYTHONUTF8": "0",
    "PYTHONCOERCECLOCALE": "0",
    "PYTHONIOENCODING": "ascii",
    "PYTHONWARNINGS": "error",
    "OMP_NUM_THREADS": "some",
    "OPENBLAS_NUM_THREADS": "some",
    "MKL_NUM_THREADS": "some",
    "TF_CPP_MIN_LOG_LEVEL": "some",
    "GRPC_POLL_STRATEGY": "some",
    "GRPC_DNS_RESOLVER": "some",
    "PROTOCOL_BUFFERS_PYTHON_IMPLEMENTATION": "some",
    "TORCH_LOGS": "some",
    "NUMBA_DISABLE_JIT": "1",  # would leave loops in Python
    "NUMBA_NUM_THREADS": "some",
    "NUMBA_CACHE_DIR": "/proc/none",
}
SMALL = ("--steps", "256", "--num-areas", "8", "--eval-episodes", "2")


def trained(folder: Path, **surroundings: str) -> subprocess.CompletedProcess[bytes]:
    command = [str(BIN / "corridor"), "train", "--run-id", "r", "--results-dir", str(folder), *SMALL]
    command += ["--base-port", str(unused_port())]
    return subprocess.run(command, env={**os.environ, **surroundings}, capture_output=True, timeout=300)


@pytest.mark.slow
def test_training_ignores_what_is_said_to_other_programs(tmp_path: Path) -> None:
    run = trained(tmp_path, **HOSTILE)
    assert run.returncode == 0, run.stderr
    assert b"Traceback" not in run.stderr
    assert {path.name for path in tmp_path.glob("r/*.png")} == {"learning_curve.png", "episode_paths.png"}


@pytest.mark.slow
def test_a_broken_numba_is_named_in_a_line_and_training_does_without_it(tmp_path: Path) -> None:
    (tmp_path / "numba.py").write_text("raise ImportError('numba needs another llvmlite')")
    run = trained(tmp_path, PYTHONPATH=str(tmp_path))
    assert run.returncode == 0, run.stderr
    (line,) = [each for each in run.stderr.decode().splitlines() if "umba" in each]
    assert line == (
        "Numba can't be used (numba needs another llvmlite), so training is slower; "
        "pip install --force-reinstall numba mends it."
    )
    assert (tmp_path / "r" / "summary.json").is_file()
