"""Start and end the live view of a session: sockets for its messages, and the viewer's process."""

import logging
import os
import select
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from drivers.children import python_command, signals_of_terminal_held
from drivers.errors import InputError
from rig.config.extras import require_extra
from rig.live.feed import Inbox, Listener

START_TIMEOUT_S = 30.0
END_TIMEOUT_S = 30.0
_log = logging.getLogger("rig.live")


def check_viewer() -> None:
    """Raise `InputError` if the viewer of `--live` cannot be started."""
    require_extra("rerun", "live", "the live view needs")
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError("--live: there is no display here; watch in a browser instead: --watch")


@contextmanager
def live_session(window: bool, others: tuple[Listener, ...] = ()) -> Iterator[tuple[list[Listener], Inbox]]:
    """Yield the listeners that lifts send to, and the inbox of the terminal's view.

    window: whether to open the viewer rerun. others: further listeners. The viewer's process ends with the
    session; if it ends earlier, the session continues. Raises `InputError` as `check_viewer` does.
    """
    if window:
        check_viewer()
    with tempfile.TemporaryDirectory(prefix="rig-live-") as folder, ExitStack() as stack:
        inbox = Inbox(f"{folder}/terminal")
        stack.callback(inbox.close)
        listeners = [Listener(inbox.address, pictures=False), *others]
        if window:
            address = f"{folder}/viewer"
            stack.enter_context(_viewer(address))
            listeners.append(Listener(address, pictures=True))
        yield listeners, inbox


@contextmanager
def _viewer(address: str) -> Iterator[subprocess.Popen[str]]:
    command = python_command("-m", "rig.live.viewer", address)
    # The viewer's output goes into a file: a pipe that is not read would block it.
    log = Path(f"{address}.log")
    with log.open("w") as said, signals_of_terminal_held():
        process = subprocess.Popen(  # noqa: S603 - this program
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=said, text=True,
            env=viewer_environment(),
        )  # fmt: skip
    to_viewer, from_viewer = process.stdin, process.stdout
    try:
        ready = from_viewer and select.select([from_viewer], [], [], START_TIMEOUT_S)[0]
        if not ready or not from_viewer or from_viewer.readline() != "ready\n":
            process.kill()
            lines = log.read_text().strip().splitlines()
            raise InputError(
                f"the live viewer did not start ({lines[-1] if lines else 'no answer'}); run without --live, "
                "or check that `rerun` starts by itself"
            )
        yield process
        if process.poll() is not None:
            # If the caller has set no handler, logging prints warnings on standard error.
            _log.warning("the live viewer ended before the command did; the recordings are complete")
    finally:
        if to_viewer is not None:  # the viewer then writes everything, and ends
            with suppress(BrokenPipeError):
                to_viewer.close()
        try:
            process.wait(END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if from_viewer is not None:
            from_viewer.close()


def viewer_environment() -> dict[str, str]:
    """Return an environment in which rerun finds its viewer beside this Python, activated or not."""
    beside = str(Path(sys.executable).parent)
    return {**os.environ, "PATH": os.pathsep.join(filter(None, (beside, os.environ.get("PATH"))))}
