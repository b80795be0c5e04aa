"""Read every device of a bench; nothing is activated, and nothing moves."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from drivers.bench import Bench
from drivers.errors import DeviceError, counted
from drivers.interfaces import Arm, FrameSource, Gripper
from drivers.types import BASIC_MODE

FIRST_FRAME_S = 5.0
"""Time limit of the first frame: some sensors take seconds to start."""


@dataclass(frozen=True, slots=True)
class Reading:
    """Result of reading a device. seen: text for the operator. problem: why it cannot be read, or None."""

    device: str
    seen: str
    problem: str | None = None


def read_devices(bench: Bench) -> list[Reading]:
    """Read a frame of each camera, the fingers' opening and the arm's speed slider; then disconnect."""
    reads: list[tuple[str, Callable[[], str]]] = [
        (source.serial, partial(_frame_of, source)) for source in bench.frame_sources
    ]
    if bench.has("gripper"):
        reads.append(("gripper", partial(_fingers_of, bench.gripper)))
    if bench.has("arm"):
        reads.append(("arm", partial(_slider_of, bench.arm)))
    readings = []
    for device, read in reads:
        try:
            readings.append(Reading(device, read()))
        except DeviceError as error:
            readings.append(Reading(device, "", str(error)))
    return readings


def require_read(readings: list[Reading]) -> None:
    """Raise one `DeviceError` that names all devices that could not be read."""
    problems = [reading.problem for reading in readings if reading.problem]
    if problems:
        raise DeviceError(
            f"{len(problems)} of {counted(len(readings), 'device')} cannot be read, nothing was started: "
            f"{'; '.join(problems)}; rig doctor gives details"
        )


def _frame_of(source: FrameSource) -> str:
    try:
        source.connect()
        height, width = source.next_frame(FIRST_FRAME_S).image.shape[:2]
    finally:
        source.disconnect()
    return f"{width} x {height} px"


def _fingers_of(gripper: Gripper) -> str:
    try:
        gripper.connect()
        state = gripper.state()
    finally:
        gripper.disconnect()
    active = "activated" if state.activated else "not activated: asked for first"
    if state.mode != BASIC_MODE:
        active += f"; in {state.mode} mode: activation in {BASIC_MODE} mode is asked for first"
    return f"fingers {1e3 * state.opening_m:.1f} mm apart, {active}"


def _slider_of(arm: Arm) -> str:
    fraction = arm.speed_fraction()
    if fraction is None:
        return "no speed slider"
    return f"speed slider at {fraction:.0%}: motions run at that fraction of their speed"
