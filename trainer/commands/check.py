"""``corridor check``."""

from dataclasses import dataclass, replace
from typing import Annotated

import tyro

from trainer.commands.shared_options import Flag
from trainer.options import Options, Seconds, env_args_of_another
from trainer.terminal import Terminal


@dataclass(frozen=True)
class Check(Options):
    """Hold a player against the ML-Agents protocol as Unity keeps it, and against the corridor's contract."""

    env: str = "builtin"
    """builtin, a build's path, editor, or HOST:PORT to listen on. One not started here dials in for every sentence."""
    timeout_wait: Seconds = 20.0
    """Seconds to wait for each message of the player."""
    env_args: Annotated[tuple[str, ...], tyro.conf.arg(metavar="...", help_behavior_hint="")] = ()
    """Everything after this option is passed to the player that is started here."""
    strict: Flag = False
    """Also say which of corridor-server's own promises hold, apart: Unity keeps few, and the exit code ignores them."""

    def with_env_args(self, given: tuple[str, ...]) -> "Check":
        """The same with arguments of the player's own."""
        return replace(self, env_args=given)

    def run(self, typed: str) -> int:
        """Checks; the exit code is 1 if a sentence of the protocol or of the contract failed."""
        from trainer.players.location import can_be_launched, check_launchable

        check_launchable(self.env)
        if self.env_args and not can_be_launched(self.env):
            raise env_args_of_another(self.env)
        from trainer.conformance.checker import check_player

        return 0 if check_player(self.env, self.env_args, self.timeout_wait, self.strict, Terminal()) else 1
