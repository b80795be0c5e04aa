"""Pickles of strangers: plain values are read as Python reads them, crafted files end in a typed error."""

import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given

from drivers.errors import FormatError
from rig.frames.plain_pickle import read_plain_pickle
from support.fuzz import answered, changed, fuzzed

ARRAYS: dict[str, Any] = {
    "uint8": np.arange(24, dtype=np.uint8).reshape(2, 4, 3),
    "poses": np.tile(np.eye(4), (3, 1, 1)),
    "big-endian": np.arange(4, dtype=">i4"),
    "columns first": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "empty": np.zeros((0, 4, 4), np.float32),
    "booleans": np.array([True, False]),
    "single": np.float64(1.5),
}
PLAIN: dict[str, Any] = {
    "texts": ["a", "é" * 300, ""],
    "numbers": [0, 255, 65_535, -1, 2**40, 1.5, True, None],
    "bytes": [b"", b"png" * 200],
    "nested": {"a": ({}, [], (), (1,), (1, 2), (1, 2, 3), (1, 2, 3, 4)), 7: [[1]]},
}


def _call(name: bytes, *arguments: bytes) -> bytes:
    return b"c" + name + b"\n(" + b"".join(arguments) + b"tR"


def _tuple(*values: bytes) -> bytes:
    return b"(" + b"".join(values) + b"t"


def _text(text: str) -> bytes:
    return b"\x8c" + bytes([len(text)]) + text.encode()


def _whole(number: int) -> bytes:
    return b"J" + number.to_bytes(4, "little", signed=True)


def _sequence(value: bytes) -> bytes:
    """A file with this value in place of the images and of the poses."""
    return b"\x80\x04}(" + _text("digit_index") + value + _text("object_index_rel_pose_n5") + value + b"u."


NOTHING, POINTERS = b"N", b"C\x20" + b"A" * 32
OBJECT = _call(b"numpy\ndtype", _text("O"))


def _array(shape: int, dtype: bytes) -> bytes:
    return _call(b"numpy\nndarray", _tuple(_whole(shape)), dtype, POINTERS)


def _structured(subarray: bytes, names: bytes, fields: bytes) -> bytes:
    """An 8-byte data type whose state declares its bytes as objects."""
    state = _tuple(
        _whole(3), _text("|"), subarray, names, fields, _whole(8), _whole(1), _whole(0)
    )  # fmt: skip
    return _call(b"numpy\ndtype", _text("V8")) + state + b"b"


CRASHES = {
    "object array over bytes": _sequence(_array(4, OBJECT)),
    "object array named by a text": _sequence(_array(4, _text("O"))),
    "field of objects": _sequence(
        _array(
            4, _structured(NOTHING, _tuple(_text("a")), b"}" + _text("a") + _tuple(OBJECT, _whole(0)) + b"s")
        )
    ),
    "subarray of objects": _sequence(
        _array(4, _structured(_tuple(OBJECT, _tuple(_whole(1))), NOTHING, NOTHING))
    ),
    "deeply nested key": b"\x80\x04})" + b"\x85" * 1_000_000 + b"Ns.",
}
"""Each ended Python's own unpickler, restricted to numpy's arrays, with a segmentation fault."""
READ = """
import sys
from pathlib import Path
from drivers.errors import FormatError
from rig.frames.public_sets import read_bag
try:
    print(read_bag(Path(sys.argv[1]), "index").images)
except FormatError as error:
    print(f"FormatError: {error}")
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", CRASHES)
def test_crafted_pickle_is_rejected_without_memory_corruption(tmp_path: Path, name: str) -> None:
    path = tmp_path / "bag_00.pkl"
    path.write_bytes(CRASHES[name])
    done = subprocess.run([sys.executable, "-c", READ, path], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith(f"FormatError: {path}: is not a sequence of digit-pose-estimation (")


@pytest.mark.parametrize("protocol", [2, 3, 4])
def test_plain_values_are_read_as_python_reads_them(protocol: int) -> None:
    values = PLAIN if protocol > 2 else {key: value for key, value in PLAIN.items() if key != "bytes"}
    assert read_plain_pickle(pickle.dumps(values, protocol)) == values


@pytest.mark.parametrize("protocol", [3, 4])
@pytest.mark.parametrize("name", ARRAYS)
def test_arrays_are_read_as_numpy_reads_them(name: str, protocol: int) -> None:
    wanted = ARRAYS[name]
    found = read_plain_pickle(pickle.dumps([wanted, wanted], protocol))
    for array in found:
        assert array.dtype == wanted.dtype
        assert array.tobytes("A") == wanted.tobytes("A")
        assert np.array_equal(array, wanted)
    assert found[0] is found[1]


def test_arrays_of_numpy_1_are_read() -> None:
    data = pickle.dumps(ARRAYS["poses"], 3).replace(b"numpy._core.", b"numpy.core.")
    assert np.array_equal(read_plain_pickle(data), ARRAYS["poses"])


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (pickle.dumps(np.array([b""], object)), "array of type 'O8'"),
        (pickle.dumps(np.array(["a"])), "array of type 'U1'"),
        (pickle.dumps(np.zeros(1, "f4,i4")), "array of type 'V8'"),
        (pickle.dumps({(1, 2): 3}), "neither a string nor an integer"),
        (pickle.dumps({1, 2}), "instruction EMPTY_SET"),
        (pickle.dumps(2**70), "more than 64 bits"),
        (pickle.dumps(Path.touch), "refers to 'pathlib.Path.touch', which arrays do not need"),
        (pickle.dumps(ARRAYS["poses"]).replace(b"K\x03K\x04K\x04", b"K\x04K\x04K\x04"), "with 384 bytes"),
        (pickle.dumps([1])[:-1], "not a complete pickle"),
        (b"", "not a complete pickle"),
        (b"\x80\x04B\xff\xff\xff\xffshort.", "not a complete pickle"),
        (b"\x80\x04h\x07.", "not a complete pickle"),
        (b"\x80\x04e.", "not a complete pickle"),
        (b"\x80\x04NR.", "not a complete pickle"),
    ],
)
def test_other_content_is_rejected(data: bytes, message: str) -> None:
    with pytest.raises(FormatError, match=message):
        read_plain_pickle(data)


@fuzzed()
@given(
    changed([pickle.dumps(ARRAYS), pickle.dumps(PLAIN, 2), pickle.dumps(PLAIN), *list(CRASHES.values())[:4]])
)
def test_damaged_pickles_end_in_a_typed_error(data: bytes) -> None:
    answered(lambda: read_plain_pickle(data))
