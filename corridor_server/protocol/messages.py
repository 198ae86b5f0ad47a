"""Message classes of the ML-Agents protocol, made from our own ``proto/`` for whatever protobuf is installed.

``messages.binpb`` is the compiled descriptor set (``make proto``). Building classes from it at import, rather than
committing code that one protoc release generated, keeps them working, and C-backed, across protobuf releases.
"""

from collections.abc import Iterator
from importlib.resources import files
from types import ModuleType
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool
from google.protobuf.internal import builder
from google.protobuf.message import Message
from google.protobuf.unknown_fields import UnknownFieldSet

SERVICE = "communicator_objects.UnityToExternalProto"
EXCHANGE = f"/{SERVICE}/Exchange"
API_VERSION = "1.5.0"
ACADEMY = "AcademySingleton"  # what every Unity player calls itself
OK, STOP = 200, 400  # a header's status: the session goes on, or ends
UNCOMPRESSED, PNG = 0, 1  # CompressionTypeProto
MAX_MESSAGE_BYTES = 256 * 2**20  # either end receives; gRPC's own limit is 4 MiB


def _build() -> dict[str, ModuleType]:
    """One module for each proto file, as protoc would have generated it, by name such as ``header_pb2``."""
    pool = descriptor_pool.Default()
    modules = {}
    data = (files("corridor_server.protocol") / "messages.binpb").read_bytes()
    for file in descriptor_pb2.FileDescriptorSet.FromString(data).file:
        pool.AddSerializedFile(file.SerializeToString())
        name = file.name.removesuffix(".proto").replace("/", ".") + "_pb2"
        module = ModuleType(name, doc=f"Messages of {file.name}.")
        descriptor = pool.FindFileByName(file.name)
        vars(module)["DESCRIPTOR"] = descriptor
        builder.BuildMessageAndEnumDescriptors(descriptor, vars(module))
        builder.BuildTopDescriptorsAndMessages(descriptor, name, vars(module))
        modules[name.rpartition(".")[2]] = module
    return modules


MODULES = _build()


def _message(module: str, name: str) -> Any:
    return getattr(MODULES[module], name)


UnityMessageProto = _message("unity_message_pb2", "UnityMessageProto")
AgentInfoProto = _message("agent_info_pb2", "AgentInfoProto")
AgentActionProto = _message("agent_action_pb2", "AgentActionProto")
STEP, RESET, QUIT = (MODULES["command_pb2"].CommandProto.Value(name) for name in ("STEP", "RESET", "QUIT"))


def mistyped_field(message: Message, at: str = "") -> str | None:
    """Finds a field that was sent as another type than its own, which protobuf leaves out as if it had not come.

    Args:
        message: As it was parsed.
        at: Where it stands in a larger one.

    Returns:
        Its place, such as ``unity_output.rl_output.agentInfos["Corridor?team=0"].value[1].reward``; None if there is
        none. Fields that this version of the protocol does not have are later ones', and no fault.
    """
    unknown_fields: Any = UnknownFieldSet(message)  # its type information lacks that it can be iterated over
    for unknown in unknown_fields:
        field = message.DESCRIPTOR.fields_by_number.get(unknown.field_number)
        if field is not None:
            return f"{at}{field.name}"
    for field, value in message.ListFields():
        if field.message_type is None:
            continue
        for place, part in _parts(field, value):
            found = mistyped_field(part, f"{at}{place}.")
            if found is not None:
                return found
    return None


def _parts(field: Any, value: Any) -> Iterator[tuple[str, Message]]:
    if field.message_type.GetOptions().map_entry:
        yield from ((f'{field.name}["{key}"]', value[key]) for key in value)
    elif isinstance(value, Message):
        yield field.name, value
    else:
        yield from ((f"{field.name}[{index}]", part) for index, part in enumerate(value))
