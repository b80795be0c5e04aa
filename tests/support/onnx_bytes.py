"""Encode small ONNX files (onnx.proto) without the package onnx."""

from collections.abc import Sequence

FLOAT, INT64 = 1, 7


def varint(number: int) -> bytes:
    """Encode a non-negative integer."""
    out = b""
    while number >= 128:
        out, number = out + bytes([number & 127 | 128]), number >> 7
    return out + bytes([number])


def field(number: int, value: int | str | bytes) -> bytes:
    """Encode a field of a message."""
    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def tensor(
    name: str, dims: Sequence[int], raw: bytes = b"", whole: Sequence[int] = (), packed: bool = False
) -> bytes:
    """Encode a tensor: of float from raw bytes, or of int64. packed: whether its dimensions are packed."""
    sizes = field(1, b"".join(map(varint, dims))) if packed else b"".join(field(1, size) for size in dims)
    data = field(7, b"".join(map(varint, whole))) if whole else field(9, raw)
    return sizes + field(2, INT64 if whole else FLOAT) + field(8, name) + data


def sparse(name: str, dims: Sequence[int]) -> bytes:
    """Encode a sparse tensor with one value."""
    values, indices = tensor(name, [1], bytes(4)), field(1, 1) + field(2, INT64) + field(7, varint(0))
    return field(1, values) + field(2, indices) + b"".join(field(3, size) for size in dims)


def node(kind: str, inputs: Sequence[str], outputs: Sequence[str], *attributes: bytes) -> bytes:
    """Encode a node of a graph."""
    ends = b"".join(field(1, name) for name in inputs) + b"".join(field(2, name) for name in outputs)
    return ends + field(4, kind) + b"".join(field(5, attribute) for attribute in attributes)


def segmentation(nodes: Sequence[bytes], tensors: Sequence[bytes] = (), more: bytes = b"") -> bytes:
    """Encode a network that maps `x` (1, 3, 32, 32) to `y`: its first channel plus the maximum of `big`."""
    maximum = node("ReduceMax", ["big"], ["m"], field(1, "keepdims") + field(3, 0) + field(20, 2))
    ends = [node("Slice", ["x", "from", "to", "to"], ["c"]), node("Add", ["c", "m"], ["y"])]
    first = field(1, 1) + field(2, INT64) + field(8, "from") + field(7, b"\0")
    ints = [first, tensor("to", [1], whole=[1])]
    return model([*nodes, maximum, *ends], [*ints, *tensors], more)


def identity_model(shape: Sequence[int], metadata: bytes = b"") -> bytes:
    """Encode a network that returns its input. metadata: of the rig."""
    extra = field(14, field(1, "rig") + field(2, metadata)) if metadata else b""
    return model([node("Identity", ["x"], ["y"])], shapes=(shape, shape)) + extra


def model(
    nodes: Sequence[bytes],
    tensors: Sequence[bytes] = (),
    more: bytes = b"",
    shapes: tuple[Sequence[int], Sequence[int]] = ((1, 3, 32, 32), (1, 1, 32, 32)),
) -> bytes:
    """Encode a model that maps `x` to `y`. shapes: of both. more: further fields of its graph."""
    graph = b"".join(field(1, each) for each in nodes) + field(2, "g")
    graph += b"".join(field(5, each) for each in tensors) + more
    graph += field(11, _value("x", shapes[0])) + field(12, _value("y", shapes[1]))
    return field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 17))


def _value(name: str, dims: Sequence[int]) -> bytes:
    shape = b"".join(field(1, field(1, size)) for size in dims)
    return field(1, name) + field(2, field(1, field(1, FLOAT) + field(2, shape)))
