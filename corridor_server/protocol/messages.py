"""Message classes of the ML-Agents protocol, made from our own ``proto/`` for whatever protobuf is installed.

``messages.binpb`` is the compiled descriptor set (``make proto``). Building classes from it at import, rather than
committing code that one protoc release generated, keeps them working, and C-backed, across protobuf releases.
"""

from importlib.resources import files
from types import ModuleType
from typing import Any

from google.protobuf import descriptor_pb2, descriptor_pool
from google.protobuf.internal import builder

SERVICE = "communicator_objects.UnityToExternalProto"
EXCHANGE = f"/{SERVICE}/Exchange"
API_VERSION = "1.5.0"
ACADEMY = "AcademySingleton"  # what every Unity player calls itself
OK, STOP = 200, 400  # a header's status: the session goes on, or ends
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
