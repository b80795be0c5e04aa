"""Frames in a file of numpy: one array, (T, H, W, 3) uint8 RGB, as `.npy`, or alone in an `.npz`."""

import lzma
import math
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO

import numpy as np
from numpy.lib import format as npy

from drivers.errors import InputError
from drivers.formats import MOST_PIXELS, reason
from drivers.types import Image

ARRAY_SUFFIXES = (".npy", ".npz")
_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
_DAMAGE = (
    OSError, EOFError, ValueError, TypeError, KeyError, RuntimeError, MemoryError, SyntaxError, OverflowError,
    tokenize.TokenError, zipfile.BadZipFile, zlib.error, lzma.LZMAError,
)  # fmt: skip
"""What damaged bytes lead to in numpy and zipfile."""


def array_shape(path: Path) -> tuple[int, int, int]:
    """Return the number of frames, their height and their width. Raises `InputError`."""
    with _opened(path) as (_, shape):
        return shape


def array_frames(path: Path) -> Iterator[Image]:
    """Yield the frames one by one, (H, W, 3) uint8 RGB: they need not fit the memory. Raises `InputError`."""
    with _opened(path) as (stream, (count, height, width)):
        for _ in range(count):
            data = stream.read(height * width * 3)
            if len(data) < height * width * 3:
                raise EOFError("it is cut short")
            yield np.frombuffer(data, np.uint8).reshape(height, width, 3)


@contextmanager
def _opened(path: Path) -> Iterator[tuple[IO[bytes], tuple[int, int, int]]]:
    """Open the array's data, behind its header, with its number of frames, their height and width."""
    try:
        with ExitStack() as stack:
            if path.suffix.lower() == ".npz":
                archive = stack.enter_context(zipfile.ZipFile(path))
                inside = archive.infolist()
                if len(inside) != 1:
                    raise ValueError(f"it holds {len(inside)} arrays, not one")
                stream, size = stack.enter_context(archive.open(inside[0])), inside[0].file_size
            else:
                stream, size = stack.enter_context(path.open("rb")), path.stat().st_size
            yield stream, _shape(stream, size)
    except _DAMAGE as error:
        raise InputError(
            f"{path}: cannot be read as frames ({reason(error)}): save one array (T, H, W, 3) of uint8, RGB"
        ) from error


def _shape(stream: IO[bytes], size: int) -> tuple[int, int, int]:
    """Read the header. Raises one of `_DAMAGE`."""
    version = npy.read_magic(stream)
    if version not in _HEADERS:
        raise ValueError(f"its format is {version[0]}.{version[1]}")
    shape, fortran, kind = _HEADERS[version](stream)
    if kind != np.uint8 or len(shape) != 4 or shape[3] != 3 or min(shape) < 1:
        raise ValueError(f"it is {kind} of shape {shape}")
    if fortran or shape[1] * shape[2] > MOST_PIXELS:
        raise ValueError(
            "its frames are not stored one after another" if fortran else "its frames are too large"
        )
    if math.prod(shape) > size - stream.tell():
        raise ValueError("it is cut short")
    return shape[:3]
