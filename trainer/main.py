"""The ``corridor`` command's first lines: nothing that takes long is imported before they can answer a signal."""

import sys
from collections.abc import Sequence

from trainer.signals import ended_by_signals
from trainer.surroundings import ignore_surroundings


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command; returns the process's exit code.

    Args:
        arguments: Of the command. The process's own if not given: then the process is the command's, signals and all.
    """
    if arguments is not None:
        return _run(list(arguments))
    with ended_by_signals():
        from corridor_server.shared.standard_streams import drop_failing_output

        drop_failing_output()
        ignore_surroundings()
        return _run(sys.argv[1:])


def _run(arguments: list[str]) -> int:
    if arguments == ["--version"]:
        from importlib.metadata import version

        print(f"corridor {version('curious-corridor')}")
        return 0
    try:
        from trainer.command_line import run_command

        return run_command(arguments)
    except ModuleNotFoundError as error:
        if str(error.name).startswith(("trainer", "corridor_server")):
            raise
        print(
            f"error: corridor needs {error.name}, which is not installed; run pip install 'curious-corridor[trainer]'.",
            file=sys.stderr,
        )
        return 1


if __name__ == "__main__":
    sys.exit(main())
