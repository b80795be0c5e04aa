"""Findings on the devices of a bench, and the first of them, for which each device is read once.

They are shown before a session begins and by `--dry-run`; `rig doctor` makes them and measures further.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from typing import TypeVar

from drivers.bench import Bench
from drivers.clock import NS_PER_S, Clock
from drivers.errors import RigError
from drivers.interfaces import Arm, Device, FrameSource, Gripper
from drivers.types import BASIC_MODE, Frame
from rig.config import BenchConfig

FIRST_FRAME_S = 5.0
"""Time limit of the first frame: drivers discard frames after opening; some sensors take seconds to start."""
DARK_GREY = 8.0
"""Mean brightness below which a picture is too dark."""

Answer = TypeVar("Answer")


class Severity(StrEnum):
    """Severity of a finding."""

    GOOD = "good"
    WARNING = "warning"
    FAILURE = "failure"
    NOTE = "note"


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check: device, check, observation and advice (empty if none is needed).

    figures: the numbers in `seen`, for scripts; units are in the names.
    """

    device: str
    check: str
    verdict: Severity
    seen: str
    todo: str = ""
    figures: Mapping[str, float | int | str | None] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        return self.verdict is Severity.FAILURE

    def __str__(self) -> str:
        return f"{self.device} {self.check}: {self.seen}" + (f"; {self.todo}" if self.todo else "")


def assess(
    device: str,
    check: str,
    good: bool,
    seen: str,
    todo: str,
    figures: Mapping[str, float | int | str | None] | None = None,
    otherwise: Severity = Severity.WARNING,
) -> Finding:
    """Return a good finding, or one of severity `otherwise` with advice `todo`."""
    verdict = Severity.GOOD if good else otherwise
    return Finding(device, check, verdict, seen, "" if good else todo, figures or {})


def first_findings(bench: Bench, config: BenchConfig) -> list[Finding]:
    """Read a frame of each camera, the fingers' state and the arm's speed slider; nothing moves.

    The arm is not connected; the other devices are disconnected at the end.
    """
    sizes_px = {sensor.serial: sensor.size_px for sensor in config.sensors}
    findings: list[Finding] = []
    for source in bench.frame_sources:
        frame = read_source(source, bench.clock, findings)
        if frame is not None:
            findings.append(assess_picture(frame, sizes_px[source.serial]))
        source.disconnect()
    if bench.has("gripper"):
        read_gripper(bench.gripper, bench.clock, findings)
        bench.gripper.disconnect()
    if bench.has("arm"):
        findings.append(read_slider(bench.arm))
    return findings


def reach(
    device: str, driver: Device, read: Callable[[], Answer], clock: Clock, findings: list[Finding]
) -> Answer | None:
    """Connect a device, and return its first answer; None if it has none.

    findings: gets the device's identity, or its driver's message, which contains the advice.
    """
    began = clock.now_ns()
    try:
        driver.connect()
        answer = read()
    except RigError as error:
        findings.append(_failure(device, error))
        return None
    took_s, identity = (clock.now_ns() - began) / NS_PER_S, driver.identity()
    text = ", ".join(f"{key} {value}" for key, value in identity.items() if value)
    seen = f"after {took_s:.2f} s" + (f": {text}" if text else "")
    figures = {"connect_s": took_s, **identity}
    findings.append(Finding(device, "reached", Severity.GOOD, seen, figures=figures))
    return answer


def read_source(source: FrameSource, clock: Clock, findings: list[Finding]) -> Frame | None:
    """Connect a camera or fingertip, and return its first frame, as `reach` does."""
    return reach(source.serial, source, partial(source.next_frame, FIRST_FRAME_S), clock, findings)


def assess_picture(frame: Frame, size_px: tuple[int, int]) -> Finding:
    """Compare a frame with the width and height in the bench file, and check that it is not dark."""
    height, width = frame.image.shape[:2]
    brightness = float(frame.image.mean())
    seen = f"{width} x {height} px, mean brightness {brightness:.0f} of 255"
    figures = {"width_px": width, "height_px": height, "brightness": brightness}
    if (width, height) != size_px:
        todo = f"the bench file has {size_px[0]} x {size_px[1]}: correct it, or choose another rate"
        return Finding(frame.serial, "picture", Severity.FAILURE, seen, todo, figures)
    todo = "take the cap off, or check the LEDs"
    return assess(frame.serial, "picture", brightness >= DARK_GREY, seen, todo, figures)


def read_gripper(gripper: Gripper, clock: Clock, findings: list[Finding]) -> bool:
    """Connect the gripper, and report its state; return whether it answers. It is not activated."""
    state = reach("gripper", gripper, gripper.state, clock, findings)
    if state is None:
        return False
    activated = "activated" if state.activated else "not activated (each trial asks first)"
    seen = f"{activated}, fingers {1e3 * state.opening_m:.1f} mm apart"
    findings.append(Finding("gripper", "state", Severity.GOOD if state.activated else Severity.NOTE, seen))
    if state.mode != BASIC_MODE:
        todo = f"each trial asks to activate it in {BASIC_MODE} mode before the first motion"
        findings.append(Finding("gripper", "grasp mode", Severity.WARNING, state.mode, todo))
    return True


def read_slider(arm: Arm) -> Finding:
    """Return the position of the arm's speed slider, which is read without connecting to the arm."""
    try:
        fraction = arm.speed_fraction()
    except RigError as error:
        return _failure("arm", error)
    if fraction is None:
        return Finding("arm", "speed slider", Severity.NOTE, "none")
    seen = f"at {fraction:.0%}: motions run at that fraction of their speed"
    return Finding("arm", "speed slider", Severity.GOOD, seen, figures={"speed_fraction": fraction})


def _failure(device: str, error: RigError) -> Finding:
    seen, _, todo = str(error).partition("; ")
    seen = seen.removeprefix(f"{device}: ")
    return Finding(device, "reached", Severity.FAILURE, seen, todo or "check power, cable and address")
