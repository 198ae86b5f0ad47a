"""Exported policies as onnxruntime has them."""

from pathlib import Path

import onnxruntime

FLOAT, INT = "tensor(float)", "tensor(int64)"


def session(program: bytes | Path) -> onnxruntime.InferenceSession:
    source = program if isinstance(program, bytes) else str(program)
    return onnxruntime.InferenceSession(source, providers=["CPUExecutionProvider"])


def form(nodes: list[onnxruntime.NodeArg]) -> list[tuple[str, list[object], str]]:
    return [(node.name, node.shape, node.type) for node in nodes]
