"""Where a player is: which program is launched, or on which address one is awaited."""

import glob
import os
import platform
import shutil
import sys
from pathlib import Path

from mlagents_envs import env_utils

from corridor_server.shared.addresses import LOOPBACK, parse_address, parse_host
from corridor_server.shared.given import shown
from trainer.config import BASE_PORT, ConnectionOptions, RunConfig
from trainer.errors import TrainerError

BUILTIN, EDITOR = "builtin", "editor"
EDITOR_PORT = 5004  # UnityEnvironment.DEFAULT_EDITOR_PORT, which takes seconds to import
FOREIGN = {".exe": "Windows", ".app": "macOS", ".x86_64": "Linux", ".x86": "Linux"}


def can_be_launched(env: str) -> bool:
    """Whether the player is a program that the trainer starts itself, and so can start again."""
    return place(env, 0)[0] is not None


def place(env: str, port: int, listen: str = LOOPBACK) -> tuple[str | None, str, int]:
    """Executable (None: wait for a player), host and port to listen on; ``port`` is for an executable.

    Raises:
        TrainerError: The host is none, or there is no such port.
    """
    try:
        listen = parse_host(listen)
        address = parse_address(env) if os.sep not in env else None
    except ValueError as error:
        raise TrainerError(f"{shown(env)} can't be listened on: {error}") from error
    if env == BUILTIN:
        return _builtin_player(), listen, port
    if env == EDITOR:
        return None, listen, EDITOR_PORT
    return (env, listen, port) if address is None else (None, *address)


def check_launchable(env: str) -> None:
    """Refuses what can be seen, without starting it, not to be a player.

    Raises:
        TrainerError: A player is to be launched, and there is none, or it may not be executed.
    """
    file_name, _, _ = place(env, 0)
    if file_name is not None:
        launch_path(file_name)


def check_connection(config: RunConfig, connection: ConnectionOptions) -> None:
    """Refuses what is asked for of ports and hosts where it has no effect, or where there are none.

    Raises:
        TrainerError: The first of them.
    """
    _, host, first = place(config.env, connection.base_port, connection.listen)
    if connection.base_port != BASE_PORT and first == place(config.env, BASE_PORT)[2]:
        raise TrainerError(f"--base-port {connection.base_port} has no effect on {config.env}, which has port {first}.")
    if connection.listen != LOOPBACK and host == place(config.env, first)[1]:
        raise TrainerError(f"--listen {connection.listen} has no effect on {config.env}, which says where to listen.")
    if first + config.num_envs - 1 > 65535:
        raise TrainerError(f"{config.num_envs} players from port {first} on need ports above 65535; begin lower.")


def launch_path(file_name: str) -> str:
    """The program that ``mlagents_envs`` would launch for a build's name.

    Raises:
        TrainerError: There is none, or it may not be executed.
    """
    if glob.escape(file_name) != file_name:
        raise TrainerError(
            f"{file_name} has *, ? or [ in its path, which mlagents_envs takes for a pattern; move or rename it."
        )
    path = env_utils.validate_environment_path(file_name)
    if path is None:
        if Path(file_name).suffix in FOREIGN and os.path.exists(file_name):
            system, here = FOREIGN[Path(file_name).suffix], platform.system()
            raise TrainerError(
                f"{file_name} is a build for {system}, but this machine runs {here}; choose {here} as the target "
                "platform in Unity's Build Settings and build again."
            )
        if os.path.isdir(file_name):
            raise TrainerError(f"{file_name} is a folder; give the path of the executable in it.")
        found = shutil.which(file_name)
        hint = f"give its path, {found}" if found else "give the path of a build's executable"
        raise TrainerError(f"There is no player {file_name} here; {hint}.")
    if not os.access(path, os.X_OK):
        raise TrainerError(f"{path} may not be executed; run 'chmod +x {path}'.")
    return str(path)


def _builtin_player() -> str:
    beside = Path(sys.executable).with_name("corridor-server")
    found = str(beside) if beside.exists() else shutil.which("corridor-server")
    if found is None:
        raise TrainerError("The command corridor-server is not installed; run 'pip install .[trainer]'.")
    return found
