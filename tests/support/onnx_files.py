"""Small ONNX files, written by hand: the library that makes them is no part of `dev`."""

from pathlib import Path


def field(number: int, value: bytes | int) -> bytes:
    """One field of a protocol buffer."""
    if isinstance(value, int):
        return bytes([number << 3]) + varint(value)
    return bytes([number << 3 | 2]) + varint(len(value)) + value


def varint(value: int) -> bytes:
    out = b""
    while value > 127:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])


def identity_network(path: Path, shape: tuple[int, ...], metadata: bytes = b"") -> Path:
    """Write an ONNX file that gives back what it is fed."""
    path.write_bytes(identity_model(shape, metadata))
    return path


def identity_model(shape: tuple[int, ...], metadata: bytes = b"") -> bytes:
    """Return such a file's bytes (onnx.proto3: fields of ModelProto)."""
    dims = b"".join(field(1, field(1, side)) for side in shape)
    tensor = field(2, field(1, field(1, 1) + field(2, dims)))
    node = field(1, b"x") + field(2, b"y") + field(4, b"Identity")
    graph = field(1, node) + field(2, b"g") + field(11, field(1, b"x") + tensor)
    graph += field(12, field(1, b"y") + tensor)
    extra = field(14, field(1, b"rig") + field(2, metadata)) if metadata else b""
    return field(1, 8) + field(7, graph) + field(8, field(2, 18)) + extra
