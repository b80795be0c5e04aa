"""Standard output and error of a command if the reader has gone (`| head`) or the disk is full."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, TextIO

from drivers.errors import RecordingError
from rig.live.screen import PlainStream, end_phase

TAIL = 4000
"""Number of printed characters that are kept."""


class Output:
    """A stream of this process whose failure does not end the command.

    If the reader has gone (`| head`), further output is discarded and the command continues its other work.
    needed: whether other write errors, such as a full disk, are raised.
    """

    def __init__(self, stream: TextIO, needed: bool) -> None:
        self._stream, self._needed = stream, needed
        self._newest = ""
        self.reader_gone = False
        """Whether the reader of the stream has closed it."""

    def tail(self) -> str:
        """The last characters that were written."""
        return self._newest

    @property
    def bare(self) -> TextIO:
        """The stream itself. Writing to it does not end a phase."""
        return self._stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write a text. Raises `RecordingError`."""
        end_phase()
        self._newest = (self._newest + text)[-TAIL:]
        try:
            return self._stream.write(text)
        except OSError as error:
            self._give_up(error)
        return len(text)

    def flush(self) -> None:
        """Flush the stream. Raises `RecordingError`."""
        try:
            self._stream.flush()
        except OSError as error:
            self._give_up(error)

    def _give_up(self, error: OSError) -> None:
        discard([self._stream.fileno()])
        self.reader_gone = isinstance(error, BrokenPipeError)
        if self._needed and not isinstance(error, BrokenPipeError):
            raise RecordingError(
                f"the output cannot be written ({error.strerror}); results stored so far are complete"
            ) from error


@contextmanager
def guarded_output() -> Iterator[Output]:
    """Guard both streams against write errors and control characters; yield standard error.

    Raises `RecordingError` if results cannot be written.
    """
    out, err = sys.stdout, sys.stderr
    said = Output(err, needed=False)
    sys.stdout, sys.stderr = PlainStream(Output(out, needed=True)), PlainStream(said)  # type: ignore[assignment]
    try:
        try:
            yield said
        finally:
            sys.stdout.flush()
            sys.stderr.flush()
    finally:
        end_phase()
        sys.stdout, sys.stderr = out, err


def discard(descriptors: list[int]) -> None:
    """Redirect descriptors to the null device, so that writing to a closed terminal is no error."""
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in descriptors:
        os.dup2(nowhere, descriptor)
    os.close(nowhere)
