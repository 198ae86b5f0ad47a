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
}


@pytest.mark.slow
def test_training_ignores_what_is_said_to_other_programs(tmp_path: Path) -> None:
    small = ("--steps", "256", "--num-areas", "8", "--eval-episodes", "2", "--base-port", str(unused_port()))
    command = [str(BIN / "corridor"), "train", "--run-id", "r", "--results-dir", str(tmp_path), *small]
    run = subprocess.run(command, env={**os.environ, **HOSTILE}, capture_output=True, timeout=300)
    assert run.returncode == 0, run.stderr
    assert b"Traceback" not in run.stderr
    assert {path.name for path in tmp_path.glob("r/*.png")} == {"learning_curve.png", "episode_paths.png"}
