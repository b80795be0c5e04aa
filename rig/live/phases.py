"""The phase that a command is in: its name is printed if the phase stays silent for a moment."""

import sys
import threading
from contextlib import suppress

SILENT_S = 0.4
"""Silence before a phase's name is printed: a command prints something within its first second."""
_pending: threading.Timer | None = None


def begin_phase(name: str) -> None:
    """Print a phase's name on stderr if nothing else is printed for `SILENT_S` from now on.

    The phase of before ends. name: what the command does, as "writing the report".
    """
    global _pending
    end_phase()
    _pending = threading.Timer(SILENT_S, _print_name, [name])
    _pending.daemon = True
    _pending.start()


def end_phase(wait: bool = False) -> None:
    """End the phase, as all other output does. wait: until its thread has ended, as before a fork."""
    global _pending
    timer, _pending = _pending, None
    if timer is not None:
        timer.cancel()
        if wait:
            timer.join()


def _print_name(name: str) -> None:
    with suppress(OSError, ValueError):  # nobody reads any more
        print(f"{name} ...", file=sys.stderr, flush=True)
