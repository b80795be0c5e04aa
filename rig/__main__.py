"""The command `rig`, and `python -m rig`, which imports nothing from the current folder either."""

import os
import signal
import sys
from collections.abc import Sequence

from rig import require_own_packages

STOPPED = 3
"""Exit code of a command that a person stopped (`rig.cli.common.Exit`)."""
ESTIMATING = (
    "trial", "replay", "live", "show", "estimate", "explain", "label-angle", "bridge", "benchmark",
)  # fmt: skip
"""Commands that estimate with `slip` unless another estimator is named."""
NO_ESTIMATE = {"-h", "--help", "--dry-run"}
"""Options with which these commands do not estimate."""


def will_estimate(arguments: Sequence[str]) -> bool:
    """Whether a command line probably needs the loops of `slip`. A wrong answer costs time only."""
    other = any(word.startswith("--estimator") for word in arguments) and "slip" not in arguments
    known = bool(arguments) and arguments[0] in ESTIMATING
    return known and not other and NO_ESTIMATE.isdisjoint(arguments)


def main() -> None:
    """Run the command line. Until it handles signals itself, nothing is started that has to be ended."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda *_: os._exit(STOPPED))
    if will_estimate(sys.argv[1:]):
        from rig.tactile.slip.compiling import begin_compiling

        begin_compiling(lambda work: print(work, file=sys.stderr, flush=True))
    from rig.cli.main import main as run

    run()


if __name__ == "__main__":
    if not sys.flags.safe_path:
        del sys.path[0]  # the current folder, which Python puts there for -m
    require_own_packages()
    main()
