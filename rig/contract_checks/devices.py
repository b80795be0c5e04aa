"""Find the devices that a check needs, and connect them, also after another check disconnected them."""

from collections.abc import Callable
from types import ModuleType
from typing import Any

from drivers.bench import Bench
from drivers.errors import DeviceError

EVERY = frozenset({"arm", "gripper", "frames"})
FIRST_FRAME_S, FRAME_S = 5.0, 1.0
"""Time limits for the first frame and for each further one."""


def of_test(module: ModuleType, bench: Bench) -> frozenset[str]:
    """Return the devices that a module of checks needs and the bench has: "arm", "gripper", "frames"."""
    there = {"arm": bench.has("arm"), "gripper": bench.has("gripper"), "frames": bool(bench.frame_sources)}
    return frozenset(name for name in getattr(module, "ABOUT", EVERY) if there[name])


def reconnect(bench: Bench, needed: frozenset[str] = EVERY) -> None:
    """Connect devices that the previous test disconnected, or that timed out on a loaded host."""
    for device, read in _reads(bench, needed):
        try:
            read()
        except DeviceError:
            device.disconnect()
            device.connect()
    for source in bench.frame_sources if "frames" in needed else ():
        source.next_frame(FIRST_FRAME_S)


def _reads(bench: Bench, needed: frozenset[str]) -> list[tuple[Any, Callable[[], object]]]:
    sources = bench.frame_sources if "frames" in needed else ()
    reads: list[tuple[Any, Callable[[], object]]] = []
    for source in sources:
        reads.append((source, lambda source=source: source.newest_frame(FRAME_S)))
    if "gripper" in needed:
        reads.append((bench.gripper, bench.gripper.state))
    if "arm" in needed:
        reads.append((bench.arm, bench.arm.state))
    return reads
