"""What a trainer says to a player, as messages: whoever plays the trainer's part builds them here.

They are built field by field; the STEP for many agents, which a trainer sends all the time, is ``columnar``'s.
"""

from collections.abc import Collection, Mapping, Sequence
from itertools import zip_longest
from typing import Any

from corridor_server.protocol.messages import API_VERSION, OK, QUIT, STEP, STOP, UnityMessageProto


def trainer_message(inputs: Any) -> Any:
    """The message (UnityMessageProto) with status 200 around a UnityInputProto."""
    message = UnityMessageProto()
    message.header.status = OK
    message.unity_input.CopyFrom(inputs)
    return message


def initialization(
    seed: int = 0,
    num_areas: int = 1,
    version: str = API_VERSION,
    package: str = "0.28.0",
    without: Collection[str] = (),
) -> Any:
    """The trainer's answer to a player's first message; it has every capability but those named in ``without``."""
    message = UnityMessageProto()
    message.header.status = OK
    parameters = message.unity_input.rl_initialization_input
    parameters.seed = seed
    parameters.num_areas = num_areas
    parameters.communication_version = version
    parameters.package_version = package
    capabilities = parameters.capabilities
    for name in capabilities.DESCRIPTOR.fields_by_name:
        setattr(capabilities, name, name not in without)
    return message


def command(number: int, side_channel: bytes = b"") -> Any:
    """A command without actions."""
    message = UnityMessageProto()
    message.header.status = OK
    message.unity_input.rl_input.command = number
    message.unity_input.rl_input.side_channel = side_channel
    return message


def step(
    actions: Mapping[str, Sequence[Sequence[float]]],
    side_channel: bytes = b"",
    deprecated: bool = False,
    discrete: Mapping[str, Sequence[Sequence[int]]] | None = None,
) -> Any:
    """STEP with a row of actions for each agent that asked, in sent order.

    Args:
        actions: Behavior -> the continuous actions of each of its agents.
        side_channel: Bytes for the player's side channels.
        deprecated: Fill the field that trainers before version 1.3 of the protocol fill.
        discrete: Behavior -> the choice in each branch of each of its agents; a hybrid behavior stands in both.
    """
    message = command(STEP, side_channel)
    choices = discrete or {}
    for behavior in dict.fromkeys((*actions, *choices)):
        value = message.unity_input.rl_input.agent_actions[behavior].value
        for row, chosen in zip_longest(actions.get(behavior, ()), choices.get(behavior, ()), fillvalue=()):
            action = value.add()
            if deprecated:
                action.vector_actions_deprecated.extend((*row, *chosen))
            else:
                action.continuous_actions.extend(row)
                action.discrete_actions.extend(chosen)
    return message


def quitting() -> Any:
    """The QUIT command."""
    return command(QUIT)


def stopping(status: int = STOP) -> Any:
    """A message with a status that ends the session."""
    message = UnityMessageProto()
    message.header.status = status
    return message
