"""Damaged and hostile input, drawn by hypothesis: a file that is whole, changed in a few places."""

from collections.abc import Callable, Sequence
from time import thread_time

import pytest
from hypothesis import settings
from hypothesis import strategies as st

from drivers.errors import RigError

PROFILE = "fuzz"
"""Its number of cases is set in `tests/conftest.py`."""
SLOWEST_S = 1.0
"""Of this thread's own time: a busy computer does not count."""
LONGEST_MESSAGE = 1000
BYTES = (b"", b"\0", b"\xff", b"\x7f", b"\x80", b"\xff" * 8, b"\0" * 8, b"\x7f" + b"\xff" * 7)


def fuzzed() -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Return a decorator that gives a fuzz test its settings and its marker."""
    return lambda test: pytest.mark.fuzz(settings.get_profile(PROFILE)(test))


def changed(whole: Sequence[bytes], pieces: Sequence[bytes] = BYTES) -> st.SearchStrategy[bytes]:
    """Draw one of some whole files with up to three places replaced by pieces, cut out or cut off.

    A place can be anywhere. A cut removes up to 40 bytes or, rarely, the rest of the file.
    """
    return st.integers(0, (1 << 110) - 1).map(lambda drawn: _changed(whole, pieces, drawn))


def _changed(whole: Sequence[bytes], pieces: Sequence[bytes], drawn: int) -> bytes:
    """Change a file. drawn: one number for all there is to choose, cheaper to draw than many."""
    drawn, number = divmod(drawn, len(whole))
    drawn, edits = divmod(drawn, 4)
    data = whole[number]
    for _ in range(edits):
        drawn, at = divmod(drawn, len(data) + 1)
        drawn, piece = divmod(drawn, len(pieces))
        drawn, cut = divmod(drawn, 42)
        data = data[:at] + pieces[piece] + (data[at + cut :] if cut < 41 else b"")
    return data


def answered(read: Callable[[], object]) -> object | None:
    """Return what a reader answers, None for a typed error that can be printed. It takes a second at most."""
    began = thread_time()
    answer, said = None, ""
    try:
        answer = read()
    except RigError as error:
        said = str(error)
    assert thread_time() - began < SLOWEST_S
    assert len(said.encode()) < LONGEST_MESSAGE
    return answer
