"""Two simulated fingertips as MJPEG streams in a separate process: `python -m support.desk_streams`.

It prints both addresses, and serves 60 frames per second each until its standard input ends.
"""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np

from drivers.clock import SystemClock
from drivers.types import Image
from fakes.devices.desk import Demonstration, DeskDigit
from fakes.wire.mjpeg.server import MjpegServer


@contextmanager
def desk_streams() -> Iterator[list[str]]:
    """Serve both streams; yield their addresses."""
    tests = Path(__file__).resolve().parents[1]
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(tests)!r}); "
               "from support.desk_streams import main; main()"]  # fmt: skip
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process.stdout.readline().split()
        finally:
            process.stdin.close()


def _drawn(digit: DeskDigit, time_ns: int) -> Image:
    return digit.draw(time_ns, np.random.default_rng(time_ns % (1 << 32)))


def main() -> None:
    clock = SystemClock()
    shown = Demonstration(clock.now_ns())
    digits = [DeskDigit(f"STREAM{side}", side, shown, clock) for side in (1, -1)]
    servers = [MjpegServer(d.serial, partial(_drawn, d), 60.0, clock) for d in digits]
    for digit, server in zip(digits, servers, strict=True):
        _drawn(
            digit, clock.now_ns() + 5 * 10**9
        )  # draw once before, because filling the caches takes a while
        server.start()
    print(*(server.url for server in servers), flush=True)
    sys.stdin.read()
    for server in servers:
        server.stop()
