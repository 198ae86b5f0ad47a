"""What the environment of a command's process says to libraries, for other programs, and would break this one."""

import os
import sys
import warnings
from io import TextIOWrapper

# Libraries that find an unknown value in these raise, and gRPC aborts the process.
MISREAD = ("GRPC_POLL_STRATEGY", "PROTOCOL_BUFFERS_PYTHON_IMPLEMENTATION", "TORCH_LOGS")
# It leaves loops that are to be compiled to Python.
SLOW = ("NUMBA_DISABLE_JIT",)


def ignore_surroundings() -> None:
    """Keeps it out of this process and of those that it starts."""
    os.environ["MPLBACKEND"] = "agg"  # Jupyter names one that may not be installed; there is no window here
    for name in (*MISREAD, *SLOW):
        os.environ.pop(name, None)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # it is None where it was closed
            stream.reconfigure(errors="backslashreplace")  # as Terminal has it, for what libraries print
    if "error" in os.environ.get("PYTHONWARNINGS", ""):  # libraries warn, and nobody here can mend it
        del os.environ["PYTHONWARNINGS"]
        warnings.resetwarnings()
        warnings.simplefilter("ignore")
