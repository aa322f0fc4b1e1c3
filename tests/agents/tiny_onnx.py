"""Write tiny networks in the ONNX format, without the package ``onnx``.

``python -m tests.agents.tiny_onnx FOLDER`` writes an ONNX policy to try ``strands-actors run`` with.

The format is protobuf. The numbers of the fields are those of ``onnx.proto3`` (onnx 1.x).
"""

from __future__ import annotations

import json
import math
import struct
import sys
from collections.abc import Sequence
from pathlib import Path

FLOAT = 1
OPSET = 13
IR_VERSION = 8


def _varint(value: int) -> bytes:
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*encoded, value])


def _number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def _bytes(field: int, content: bytes | str) -> bytes:
    content = content.encode() if isinstance(content, str) else content
    return _varint(field << 3 | 2) + _varint(len(content)) + content


def _tensor(name: str, shape: Sequence[int], values: Sequence[float]) -> bytes:
    dims = b"".join(_number(1, size) for size in shape)
    return dims + _number(2, FLOAT) + _bytes(8, name) + _bytes(9, struct.pack(f"<{len(values)}f", *values))


def _value(name: str, shape: Sequence[int | str], element: int) -> bytes:
    dims = b"".join(_bytes(1, _number(1, d) if isinstance(d, int) else _bytes(2, d)) for d in shape)
    return _bytes(1, name) + _bytes(2, _bytes(1, _number(1, element) + _bytes(2, dims)))


def _elsewhere(file: str, shape: Sequence[int]) -> bytes:
    """Return the tensor ``w`` with its values in another file (``external_data``)."""
    dims = b"".join(_number(1, size) for size in shape)
    place = {"location": file, "offset": "0", "length": str(4 * math.prod(shape))}
    entries = b"".join(_bytes(13, _bytes(1, key) + _bytes(2, value)) for key, value in place.items())
    return dims + _number(2, FLOAT) + _bytes(8, "w") + _number(14, 1) + entries


def linear(
    rows: Sequence[Sequence[float]],
    bias: Sequence[float],
    batch: int | str = 1,
    element: int = FLOAT,
    extra_input: bool = False,
    weights_in: str = "",
) -> bytes:
    """Return the network ``actions = obs @ rows + bias``.

    Args:
        rows: The matrix: a row for each input, a column for each output.
        bias: One number for each output.
        batch: First size of input and output; a text is a free size.
        element: Type of the input and output: 1 float, 11 double.
        extra_input: Add an input ``memory``, as recurrent networks have.
        weights_in: Name of another file that has the matrix; empty for the network itself.
    """
    inputs, outputs = len(rows), len(bias)
    nodes = [(("obs", "w"), "product", "MatMul"), (("product", "b"), "actions", "Add")]
    graph = b"".join(
        _bytes(1, b"".join(_bytes(1, name) for name in names) + _bytes(2, result) + _bytes(4, kind))
        for names, result, kind in nodes
    )
    graph += _bytes(2, "tiny")
    weights = _elsewhere(weights_in, (inputs, outputs)) if weights_in else b""
    graph += _bytes(5, weights or _tensor("w", (inputs, outputs), [value for row in rows for value in row]))
    graph += _bytes(5, _tensor("b", (outputs,), bias))
    graph += _bytes(11, _value("obs", (batch, inputs), element))
    if extra_input:
        graph += _bytes(11, _value("memory", (1, 4), FLOAT))
    graph += _bytes(12, _value("actions", (batch, outputs), element))
    return _number(1, IR_VERSION) + _bytes(7, graph) + _bytes(8, _number(2, OPSET))


def constant(inputs: int, bias: Sequence[float]) -> bytes:
    """Return a network that ignores its input and writes ``bias``."""
    return linear([[0.0] * len(bias)] * inputs, bias)


def write_drift(folder: Path) -> None:
    """Write an ONNX policy for an SO-101: a network that asks for 0.01 rad more of shoulder_pan in each step."""
    joints = [{"name": "shoulder_pan", "unit": "rad"}, {"name": "gripper", "unit": "share"}]
    manifest = {"format": "strands-actors-onnx", "version": 1, "file": "policy.onnx", "control_hz": 50}
    blocks = {"joints": joints, "observation": [{"block": "position"}], "action": {"kind": "delta"}}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "policy.onnx").write_bytes(constant(2, [0.01, 0.0]))
    (folder / "manifest.json").write_text(json.dumps({**manifest, **blocks}))


if __name__ == "__main__":
    write_drift(Path(sys.argv[1]))
