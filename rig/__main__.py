"""The command `rig`, and `python -m rig`, which imports nothing from the current folder either."""

import os
import signal
import sys

from rig import require_own_packages

STOPPED = 3
"""Exit code of a command that a person stopped (`rig.cli.common.Exit`)."""


def main() -> None:
    """Run the command line. Until it handles signals itself, nothing is started that has to be ended."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda *_: os._exit(STOPPED))
    from rig.cli.main import main as run

    run()


if __name__ == "__main__":
    if not sys.flags.safe_path:
        del sys.path[0]  # the current folder, which Python puts there for -m
    require_own_packages()
    main()
