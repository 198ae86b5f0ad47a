"""What a player's areas are doing, saved with a run: asked for over a side channel of our own.

Players that do not know the channel skip its messages, as the protocol has it, and answer nothing. A run with such a
player begins new episodes when it is resumed.
"""

from collections.abc import Sequence

import numpy as np
from mlagents_envs.side_channel.side_channel import IncomingMessage, OutgoingMessage, SideChannel
from numpy.typing import NDArray

from corridor_server.protocol.side_channels import AREA_STATE


class PlayerState(SideChannel):  # type: ignore[misc]  # mlagents_envs has no type information
    """The trainer's end of the channel.

    Args:
        restored: A state that the player shall take up with its first reset.

    Attributes:
        state: The player's last answer; None if it gave none.
        is_refused: Whether the player has said that it can't take up the state it was given.
    """

    def __init__(self, restored: bytes | None = None) -> None:
        super().__init__(AREA_STATE)
        self.state: bytes | None = None
        self.is_refused = False
        self._asked = self._known = False
        if restored is None:
            self.ask()  # a player that is not asked before its first episodes need not keep what they began with
        else:
            self._send(restored)

    @property
    def is_known(self) -> bool:
        """Whether the player has answered once."""
        return self._known

    def ask(self) -> None:
        """Asks for the state after the next step, unless the player has shown that it does not know the channel."""
        if self._asked and not self._known:
            return
        self._asked = True
        self._send(b"")

    def on_message_received(self, message: IncomingMessage) -> None:
        """Takes the player's state; an empty one is its refusal."""
        answer = bytes(message.get_raw_bytes())
        if not answer:
            self.is_refused = True
            return
        self._known, self.state = True, answer

    def _send(self, payload: bytes) -> None:
        message = OutgoingMessage()
        message.set_raw_bytes(bytearray(payload))
        self.queue_message_to_send(message)


def said_states(players: Sequence[PlayerState]) -> dict[str, NDArray[np.uint8]]:
    """What every player answered last, ``state_<number>``, as a checkpoint has it; nothing if one has not."""
    answers = [player.state for player in players]
    known = [np.frombuffer(answer, np.uint8) for answer in answers if answer is not None]
    return {f"state_{number}": state for number, state in enumerate(known)} if len(known) == len(answers) else {}
