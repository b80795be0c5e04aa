"""A pseudo-terminal to run commands in, with its visible text."""

import fcntl
import os
import pty
import re
import select
import struct
import subprocess
import termios
import time

from support.waiting import LIMIT_S

_PIECES = re.compile(rb"\x1b\[([?\d;]*)([A-Za-z])|([\r\n])|([^\x1b\r\n]+)")


class Terminal:
    """A child process at a pseudo-terminal with a given number of columns. `rows` is its visible text."""

    def __init__(self, command: list[str], columns: int) -> None:
        self._ours, theirs = pty.openpty()
        fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 50, columns, 0, 0))
        environment = {k: v for k, v in os.environ.items() if k not in ("COLUMNS", "LINES", "NO_COLOR")}
        self.process = subprocess.Popen(
            command, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
            env={**environment, "TERM": "xterm"},
            preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0) and None,
        )  # fmt: skip
        os.close(theirs)
        self._columns = columns
        self._row = self._column = 0
        self.rows = [""]

    def read_for(self, seconds: float) -> None:
        """Read the output for a while."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0.0:
            if select.select([self._ours], [], [], left)[0]:
                try:
                    self._show(os.read(self._ours, 65536))
                except OSError:  # the child is gone
                    return

    def wait_for(self, text: str, limit_s: float = LIMIT_S) -> str:
        """Read until a text stands there; return the rows as one text."""
        end = time.monotonic() + limit_s
        while text not in self.text():
            assert time.monotonic() < end, f"'{text}' not seen; there stands:\n{self.text()}"
            assert self.process.poll() is None or self.readable(), f"ended; there stands:\n{self.text()}"
            self.read_for(0.05)
        return self.text()

    def readable(self) -> bool:
        """Whether something is left to be read."""
        return bool(select.select([self._ours], [], [], 0.1)[0])

    def type(self, text: str) -> None:
        """Type as a person does."""
        os.write(self._ours, text.encode())

    def text(self) -> str:
        """What stands there; a line wider than the terminal is one line."""
        return "\n".join(row.rstrip() for row in self.rows)

    def last(self) -> str:
        """The last row that is not empty."""
        return next((row.rstrip() for row in reversed(self.rows) if row.strip()), "")

    def hang_up(self) -> None:
        """Lose the terminal: who runs at it gets SIGHUP."""
        if self._ours >= 0:
            os.close(self._ours)
            self._ours = -1

    def close(self) -> None:
        """End the child, and hang up."""
        self.process.kill()
        self.process.wait()
        self.hang_up()

    def _show(self, data: bytes) -> None:
        for values, order, control, text in _PIECES.findall(data):
            if order == b"A":
                self._row = max(0, self._row - int(values or 1))
            elif order == b"K":
                self.rows[self._row] = ""
            elif control == b"\r":
                self._column = 0
            elif control == b"\n":
                self._row += 1
                self.rows += [""] * (self._row + 1 - len(self.rows))
            elif text:
                self._write(text.decode(errors="replace"))

    def _write(self, text: str) -> None:
        row = self.rows[self._row].ljust(self._column)
        self.rows[self._row] = row[: self._column] + text + row[self._column + len(text) :]
        self._column += len(text)
