"""Read pickled numbers, strings, bytes, lists, dicts and numeric numpy arrays without Python's unpickler.

Python's unpickler calls any function that a file names, and numpy's C code trusts the state in a pickled
array or data type: a crafted file can crash the process or corrupt its memory. Here the standard library only
splits the file into instructions (`pickletools.genops`). The instructions below build plain values, and all
others are refused. An array is created from its bytes only after its shape, data type and length have been
checked.
"""

import math
import pickletools
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.errors import FormatError
from drivers.formats import reason, shown

NAMES = {
    ("numpy", "ndarray"): "ndarray",
    ("numpy", "dtype"): "dtype",
    **{
        (f"numpy.{core}.multiarray", name): name
        for core in ("core", "_core")
        for name in ("_reconstruct", "scalar")
    },
}
"""Names in pickled arrays of numpy 1 and 2, with the rule that each one selects. Nothing is imported."""
MOST_DIMENSIONS = 8
_NUMBERS = re.compile(r"b1|[iu][1248]|f[248]")
"""Accepted data types: booleans, integers and floats of fixed size, but no objects, strings or fields."""
_WHOLE = ("BININT", "BININT1", "BININT2", "LONG1")
_VALUES = (
    "BINFLOAT", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8",
    *_WHOLE,
)  # fmt: skip
_CONSTANTS: dict[str, Callable[[], Any]] = {
    "NONE": lambda: None, "NEWTRUE": lambda: True, "NEWFALSE": lambda: False,
    "EMPTY_LIST": list, "EMPTY_DICT": dict, "EMPTY_TUPLE": tuple,
}  # fmt: skip
_TUPLES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
_IGNORED = ("PROTO", "FRAME")


class _Name:
    """A name from `NAMES` that the file contains."""

    def __init__(self, rule: str) -> None:
        self.rule = rule


class _Unbuilt:
    """A data type or an array whose state follows. keys: its keys in the file's memo."""

    def __init__(self, rule: str, code: str = "") -> None:
        self.rule, self.code = rule, code
        self.keys: list[int] = []


def read_plain_pickle(data: bytes) -> Any:
    """Return the plain value in a pickle of protocol 2 or later. Raises `FormatError` for other content."""
    try:
        return _Reader().read(data)
    except FormatError:
        raise
    except (ValueError, TypeError, LookupError, EOFError, MemoryError, OverflowError) as error:
        raise FormatError(f"it is not a complete pickle ({reason(error)})") from error


class _Reader:
    """The state of the pickle machine: its stack, the marks on the stack, and the memo (values by number)."""

    def __init__(self) -> None:
        self._stack: list[Any] = []
        self._marks: list[int] = []
        self._memo: dict[int, Any] = {}
        self._steps: dict[str, Callable[[Any], None]] = {
            "MARK": self._mark, "TUPLE": self._tuple,
            "APPEND": self._append, "APPENDS": self._appends,
            "SETITEM": self._set_item, "SETITEMS": self._set_items,
            "MEMOIZE": self._memoize, "BINPUT": self._put, "LONG_BINPUT": self._put,
            "BINGET": self._get, "LONG_BINGET": self._get,
            "GLOBAL": self._global, "STACK_GLOBAL": self._stack_global,
            "REDUCE": self._reduce, "BUILD": self._build,
        }  # fmt: skip

    def read(self, data: bytes) -> Any:
        """Execute the instructions of a file; return the value on the stack at its end."""
        for opcode, argument, _ in pickletools.genops(data):
            if opcode.name == "STOP":
                return self._stack.pop()
            self._follow(opcode.name, argument)
        raise EOFError("the end is missing")

    def _follow(self, name: str, argument: Any) -> None:
        if name in _VALUES:
            self._stack.append(_bounded(argument) if name in _WHOLE else argument)
        elif name in _CONSTANTS:
            self._stack.append(_CONSTANTS[name]())
        elif name in _TUPLES:
            self._stack.append(tuple(self._popped(_TUPLES[name])))
        elif name not in _IGNORED:
            step = self._steps.get(name)
            if step is None:
                raise FormatError(f"it contains the instruction {name}, which plain values do not need")
            step(argument)

    def _popped(self, count: int) -> list[Any]:
        """Remove the newest values from the stack; return them, oldest first."""
        if count > len(self._stack) - (self._marks[-1] if self._marks else 0):
            raise IndexError("too few values")
        values = self._stack[len(self._stack) - count :]
        del self._stack[len(self._stack) - count :]
        return values

    def _since_mark(self) -> list[Any]:
        values = self._popped(len(self._stack) - self._marks[-1])
        self._marks.pop()
        return values

    def _mark(self, _: Any) -> None:
        self._marks.append(len(self._stack))

    def _tuple(self, _: Any) -> None:
        self._stack.append(tuple(self._since_mark()))

    def _append(self, _: Any) -> None:
        self._extend(self._popped(1))

    def _appends(self, _: Any) -> None:
        self._extend(self._since_mark())

    def _extend(self, values: list[Any]) -> None:
        _of(list, self._stack[-1]).extend(values)

    def _set_item(self, _: Any) -> None:
        self._update(self._popped(2))

    def _set_items(self, _: Any) -> None:
        self._update(self._since_mark())

    def _update(self, values: list[Any]) -> None:
        # only strings and numbers are accepted: hashing a deeply nested tuple overflows the C stack
        keys = [key for key in values[::2] if type(key) in (str, int)]
        if 2 * len(keys) != len(values):
            raise FormatError("a dict in it has a key that is neither a string nor an integer")
        _of(dict, self._stack[-1]).update(zip(keys, values[1::2], strict=True))

    def _memoize(self, _: Any) -> None:
        self._put(len(self._memo))

    def _put(self, key: int) -> None:
        value = self._memo[key] = self._stack[-1]
        if isinstance(value, _Unbuilt):
            value.keys.append(key)

    def _get(self, key: int) -> None:
        self._stack.append(self._memo[key])

    def _global(self, argument: str) -> None:
        module, _, name = argument.partition(" ")
        self._name(module, name)

    def _stack_global(self, _: Any) -> None:
        self._name(*self._popped(2))

    def _name(self, module: Any, name: Any) -> None:
        rule = NAMES.get((_of(str, module), _of(str, name)))
        if rule is None:
            raise FormatError(f"it refers to {shown(f'{module}.{name}')}, which arrays do not need")
        self._stack.append(_Name(rule))

    def _reduce(self, _: Any) -> None:
        name, arguments = self._popped(2)
        rule = _of(_Name, name).rule
        if rule == "dtype":
            self._stack.append(_Unbuilt("dtype", _code(_of(tuple, arguments)[0])))
        elif rule == "_reconstruct":
            self._stack.append(_Unbuilt("array"))
        elif rule == "scalar":
            dtype, data = _of(tuple, arguments)
            self._stack.append(_array((), dtype, data, False)[()])
        else:
            raise FormatError("it calls numpy.ndarray, which arrays do not need")

    def _build(self, _: Any) -> None:
        unbuilt, state = self._popped(2)
        built = _built(_of(_Unbuilt, unbuilt), _of(tuple, state))
        self._stack.append(built)
        self._memo.update(dict.fromkeys(unbuilt.keys, built))


def _of(kind: type, value: Any) -> Any:
    """Return the value if it has exactly this type. Raises `FormatError` otherwise."""
    if type(value) is not kind:
        raise FormatError(f"it contains a {type(value).__name__} in place of a {kind.__name__}")
    return value


def _bounded(number: int) -> int:
    """Return the integer if it fits 64 bits. Larger ones could be crafted to have equal hashes."""
    if not -(2**63) <= number < 2**64:
        raise FormatError("it holds an integer of more than 64 bits")
    return number


def _code(name: Any) -> str:
    if not _NUMBERS.fullmatch(_of(str, name)):
        raise FormatError(f"it holds an array of type {shown(name)}; only numbers are read")
    return name


def _built(unbuilt: _Unbuilt, state: tuple[Any, ...]) -> np.dtype[Any] | NDArray[Any]:
    """Return the data type or the array described by a state that numpy has written."""
    if unbuilt.rule == "dtype":
        # version, byte order, and values that only fields and strings use
        if state[1] not in ("<", ">", "|", "=") or any(part is not None for part in state[2:5]):
            raise FormatError("it holds an array with fields or of unknown byte order; only numbers are read")
        return np.dtype(f"{state[1]}{unbuilt.code}")
    _, shape, dtype, column_order, data = state
    return _array(shape, dtype, data, column_order)


def _array(shape: Any, dtype: Any, data: Any, column_order: Any) -> NDArray[Any]:
    """Return an array that owns its data. Raises `FormatError` if the shape does not match the bytes."""
    if not isinstance(dtype, np.dtype) or dtype.kind not in "biuf":
        raise FormatError("it holds an array without a numeric data type")
    sizes = [_of(int, size) for size in _of(tuple, shape)]
    if len(sizes) > MOST_DIMENSIONS or min(sizes, default=0) < 0:
        raise FormatError(f"it holds an array of shape {shown(shape)}")
    if math.prod(sizes) * dtype.itemsize != len(_of(bytes, data)):
        raise FormatError(f"it holds an array of shape {shown(shape)} with {len(data)} bytes")
    order = "F" if column_order is True else "C"
    return np.ndarray(tuple(sizes), dtype, data, order=order).copy(order)
