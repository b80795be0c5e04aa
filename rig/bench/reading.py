"""Every device of a bench reached by reading alone: nothing is started on it, nothing moves."""

from contextlib import ExitStack
from dataclasses import dataclass

from drivers.bench import Bench
from drivers.errors import DeviceError
from drivers.interfaces import FrameSource

FIRST_FRAME_S = 5.0
"""Some sensors take seconds to start."""


@dataclass(frozen=True, slots=True)
class Reading:
    """What was read of a device; problem: why it was not, None where it was."""

    device: str
    seen: str
    problem: str | None = None


def read_devices(bench: Bench) -> list[Reading]:
    """Read a frame of each camera, the fingers' place, and the arm's speed slider; then let go of them."""
    return [*(_read_source(source) for source in bench.frame_sources), _read_gripper(bench), _read_arm(bench)]


def require_read(readings: list[Reading]) -> None:
    """Raise one `DeviceError` that names all devices that were not reached."""
    problems = [reading.problem for reading in readings if reading.problem]
    if problems:
        raise DeviceError(
            f"{len(problems)} of {len(readings)} devices cannot be read, nothing was started: "
            f"{'; '.join(problems)}; rig doctor tells more"
        )


def _read_source(source: FrameSource) -> Reading:
    try:
        with ExitStack() as stack:
            stack.callback(source.disconnect)
            source.connect()
            height, width = source.next_frame(FIRST_FRAME_S).image.shape[:2]
    except DeviceError as error:
        return Reading(source.serial, "", str(error))
    return Reading(source.serial, f"{width} x {height} px")


def _read_gripper(bench: Bench) -> Reading:
    gripper = bench.gripper
    try:
        with ExitStack() as stack:
            stack.callback(gripper.disconnect)
            gripper.connect()
            state = gripper.state()
    except DeviceError as error:
        return Reading("gripper", "", str(error))
    active = "activated" if state.activated else "not activated: asked for first"
    return Reading("gripper", f"fingers at {state.position_counts} counts, {active}")


def _read_arm(bench: Bench) -> Reading:
    try:
        fraction = bench.arm.speed_fraction()
    except DeviceError as error:
        return Reading("arm", "", str(error))
    if fraction is None:
        return Reading("arm", "no speed slider")
    return Reading("arm", f"speed slider at {fraction:.0%}: motions run at that share of their speed")
