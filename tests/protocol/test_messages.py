"""The wire protocol is Unity's: our descriptors against those in the published wheel."""

import ast
import importlib.util
import pickle
from pathlib import Path

import pytest
from google.protobuf import descriptor_pb2
from google.protobuf.descriptor_pb2 import FileDescriptorProto

from corridor_server.protocol.messages import MODULES

ROOT = Path(__file__).parents[2]


def published(name: str) -> FileDescriptorProto:
    """Reads the descriptor out of a generated module of the installed mlagents-envs, without importing it."""
    spec = importlib.util.find_spec("mlagents_envs")
    assert spec is not None
    assert spec.origin is not None
    source = (Path(spec.origin).parent / "communicator_objects" / f"{name}.py").read_text()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.keyword) and node.arg == "serialized_pb":
            literal = next(part for part in ast.walk(node) if isinstance(part, ast.Constant))
            text = literal.value
            data = text if isinstance(text, bytes) else text.encode("latin-1")
            return FileDescriptorProto.FromString(data)
    raise AssertionError(f"{name} holds no descriptor")


def without_json_names(file: FileDescriptorProto) -> FileDescriptorProto:
    """protoc adds these to a descriptor set; they follow from the fields' names."""
    messages = list(file.message_type)
    while messages:
        message = messages.pop()
        messages += message.nested_type
        for field in message.field:
            field.ClearField("json_name")
    return file


@pytest.mark.parametrize("name", sorted(MODULES))
def test_a_descriptor_equals_the_published_one(name):
    ours = FileDescriptorProto()
    MODULES[name].DESCRIPTOR.CopyToProto(ours)
    assert without_json_names(ours) == without_json_names(published(name))


def test_every_published_message_module_is_ours():
    spec = importlib.util.find_spec("mlagents_envs")
    assert spec is not None
    assert spec.origin is not None
    folder = Path(spec.origin).parent / "communicator_objects"
    assert {path.stem for path in folder.glob("*_pb2.py")} == set(MODULES)


def test_the_compiled_descriptors_are_those_of_the_proto_files(tmp_path):
    from grpc_tools import protoc

    proto = ROOT / "proto"
    files = sorted(str(path.relative_to(proto)) for path in proto.rglob("*.proto"))
    compiled = tmp_path / "messages.binpb"
    arguments = ["protoc", f"-I{proto}", "--include_imports", f"--descriptor_set_out={compiled}", *files]
    assert protoc.main(arguments) == 0
    committed = (ROOT / "corridor_server" / "protocol" / "messages.binpb").read_bytes()
    read = descriptor_pb2.FileDescriptorSet.FromString
    assert read(compiled.read_bytes()) == read(committed), "run 'make proto'"


def test_mlagents_envs_uses_our_classes():
    from mlagents_envs.communicator_objects.unity_message_pb2 import UnityMessageProto

    assert UnityMessageProto is MODULES["unity_message_pb2"].UnityMessageProto


def test_messages_are_parsed_by_the_c_backed_runtime_and_can_be_pickled():
    from google.protobuf.internal import api_implementation

    assert api_implementation.Type() == "upb"
    message = MODULES["unity_message_pb2"].UnityMessageProto()
    message.header.status = 200
    assert pickle.loads(pickle.dumps(message)) == message
