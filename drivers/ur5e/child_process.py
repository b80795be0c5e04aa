"""A supervised process of the arm's driver: started, watched and ended, its last words kept."""

import contextlib
import os
import signal
import subprocess
import tempfile
from pathlib import Path

from drivers.children import python_command

_ROOT = Path(__file__).resolve().parents[2]
_TAIL_BYTES = 400
_END_S = 1.0


class ChildProcess:
    """A Python module run as a child, its output kept in case it dies."""

    def __init__(self, name: str, module: str, arguments: tuple[object, ...], fds: tuple[int, ...]) -> None:
        self.name = name
        self._output = tempfile.TemporaryFile()
        paths = [str(_ROOT), *filter(None, [os.environ.get("PYTHONPATH")])]
        self._process = subprocess.Popen(  # noqa: S603 - our own module, no shell
            python_command("-m", module, *arguments),
            stdin=subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            pass_fds=fds,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(paths)},
            start_new_session=True,  # a Ctrl-C is the parent's to handle: it stops the arm first
        )

    @property
    def alive(self) -> bool:
        """Whether it still runs."""
        return self._process.poll() is None

    def death(self) -> str:
        """How it ended, with its last line of output."""
        code = self._process.poll()
        if code is None:
            return f"{self.name} runs"
        how = f"by {signal.Signals(-code).name}" if code < 0 else f"with code {code}"
        return f"{self.name} ended {how}{self._last_words()}"

    def wait(self, timeout_s: float) -> None:
        """Wait for its end, at most that long."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)

    def kill(self) -> None:
        """End it now; `death` can still tell of it."""
        self._process.kill()

    def end(self) -> None:
        """End it now and let go of what it said. Safe to call twice."""
        self._process.kill()
        self.wait(_END_S)
        self._output.close()

    def _last_words(self) -> str:
        if self._output.closed:
            return ""
        size = self._output.seek(0, os.SEEK_END)
        self._output.seek(max(0, size - _TAIL_BYTES))
        words = self._output.read().decode(errors="replace").split("\n")
        said = [line.strip() for line in words if line.strip()]
        return f" ({said[-1]})" if said else ""
