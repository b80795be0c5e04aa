"""Size of the tensors that an ONNX file declares, read from its protocol buffers without loading them.

onnxruntime allocates a sparse tensor in full when it opens a file: 200 bytes may declare gigabytes. Field
numbers are those of onnx.proto (ONNX IR version 8).
"""

from collections.abc import Iterator

from drivers.formats.unpacking import check_unpacked

_INSIDE = {
    "model": {7: "graph", 25: "function"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "function": {7: "node"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
}
"""Messages that contain tensors, by field number."""
_MERGED = {"model": (7,), "attribute": (5, 6, 22)}
"""Fields that occur once; readers join the contents of several, also their dimensions."""
_DIMS = {"tensor": 1, "sparse": 3}
"""Field of the dimensions."""
_ELEMENT_BYTES = 8
"""Size of the largest usual element (double, int64)."""
_MOST_ELEMENTS = 1 << 62
"""Products of dimensions are cut off here."""
_VARINT, _LENGTH = 0, 2
_SIZED = {1: 8, 3: 0, 4: 0, 5: 4}
"""Wire types of protocol buffers; those of fixed size with it in bytes. Groups (3, 4) are read as fields."""


def check_onnx(where: str, data: bytes) -> None:
    """Raise `FormatError` if the tensors that an ONNX file declares exceed the limit together.

    where: its name. A damaged file is counted up to its damage.
    """
    total, left = 0, [("model", memoryview(data))]
    while left:
        kind, message = left.pop()
        count = None if kind in _INSIDE else 1
        found: dict[int, list[memoryview]] = {}
        for number, value in _fields(message):
            if number in _INSIDE.get(kind, ()) and isinstance(value, memoryview):
                found.setdefault(number, []).append(value)
            elif count is not None and number == _DIMS[kind]:
                for size in [value] if isinstance(value, int) else _varints(value):
                    count = min(count * size, _MOST_ELEMENTS)
        for number, parts in found.items():
            if len(parts) > 1 and number in _MERGED.get(kind, ()):
                parts = [memoryview(b"".join(parts))]
            left += [(_INSIDE[kind][number], part) for part in parts]
        total += _ELEMENT_BYTES * (count or 0)
        check_unpacked(where, len(data), total)


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Yield number and value of each field of a message with an integer or a length, up to any damage."""
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        number, wire = tag >> 3, tag & 7
        if wire == _VARINT:
            value, at = _varint(message, at)
            yield number, value
        elif wire == _LENGTH:
            size, at = _varint(message, at)
            yield number, message[at : at + size]
            at += size
        else:
            at += _SIZED.get(wire, len(message))


def _varints(packed: memoryview) -> Iterator[int]:
    at = 0
    while at < len(packed):
        value, at = _varint(packed, at)
        yield value


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    """Return the integer at a place, and the place behind it; it ends at the latest with the message."""
    value = shift = 0
    while at < len(message):
        byte = message[at]
        value, shift, at = value | (byte & 127) << shift, shift + 7, at + 1
        if byte < 128 or shift > 63:
            break
    return value, at
