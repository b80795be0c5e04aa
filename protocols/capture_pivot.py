"""Capture poses for a tool-tip calibration: the tip is put into one small hole at several tilts.

The arm turns the tool, and a person guides the tip into the hole in small steps, because the position of the
tip is not known yet.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.bench import Bench
from drivers.errors import ContactForceError, OutOfLimitsError
from drivers.types import Pose, Vector3
from protocols.capture_hand_eye import wait_until_still
from protocols.steps import go

SPEED_M_S = 0.05
ACCELERATION_M_S2 = 0.3
"""Speed and acceleration of the tool."""
MOTION_TIMEOUT_S = 30.0
"""Time limit of a motion at full speed."""
ABOVE_M = 0.015
"""Height above the hole at which the tool is turned."""
FIRST_ABOVE_M = 0.12
"""The same before the first pose: clearance for a tip of unknown length over a hole near the mark."""
LARGEST_NUDGE_M = 0.15
MOST_NUDGES = 40
"""Limits of the person's steps: size of one, and number per pose."""

Nudge = Callable[[str], Vector3 | None]
"""Asks the person at the bench for the tip's remaining displacement, m, base axes; None when it sits."""


def capture_pivot(
    bench: Bench,
    tilts: Sequence[Rotation],
    nudge: Nudge,
    keep: Callable[[str, Pose], Vector3 | None],
    skipped: Callable[[str, str], None],
) -> None:
    """Seat the tip at each tilt (rotations of the tool from its start pose, about the base's axes).

    keep: receives id and seated pose of the TCP, and returns the estimated tip in the TCP's frame, m, or None
    while it is unknown; the better the estimate, the closer to the hole the next turn ends. skipped: receives
    the id and the reason of a pose that was not captured. Downward motions are guarded by the force at the
    tool, because the length of the tip is not known. On any error, and on a stop, the arm stops.
    """
    try:
        start = bench.arm.state().base_T_tcp
        tip: Vector3 = (0.0, 0.0, 0.0)
        mark = np.asarray(bench.base_T_table.position_m)
        _go(bench, Pose.from_rotation(np.add(mark, (0.0, 0.0, FIRST_ABOVE_M)), start.rotation))
        hole: np.ndarray | None = None
        for number, tilt in enumerate(tilts, start=1):
            name = f"{number:02d}"
            turn = tilt * start.rotation
            try:
                if hole is not None:  # rise straight up and turn there, with the estimated tip above the hole
                    _rise(bench)
                    above = np.add(hole, (0.0, 0.0, ABOVE_M)) - turn.apply(tip)
                    _go(bench, Pose.from_rotation(above, turn))
                _seat(bench, name, nudge)
            except OutOfLimitsError as error:
                skipped(name, str(error))
                continue
            wait_until_still(bench)
            pose = bench.arm.state().base_T_tcp
            tip = keep(name, pose) or tip
            hole = pose.rotation.apply(tip) + np.asarray(pose.position_m)
        _rise(bench)
    except BaseException:
        bench.arm.stop()
        raise


def _seat(bench: Bench, name: str, nudge: Nudge) -> None:
    """Step as the person requests until the tip sits; after a step that was stopped at contact, ask again.

    Raises `OutOfLimitsError` for too large a step.
    """
    stopped = ""
    for _ in range(MOST_NUDGES):
        step = nudge(f"{stopped}pose {name}: how far must the tip move?")
        if step is None:
            return
        if float(np.linalg.norm(step)) > LARGEST_NUDGE_M:
            raise OutOfLimitsError(f"pose {name}: a step of {np.linalg.norm(step):.3f} m; is it in mm?")
        pose = bench.arm.state().base_T_tcp
        stopped = ""
        try:
            _go(bench, Pose.from_rotation(np.add(pose.position_m, step), pose.rotation))
        except ContactForceError as error:
            stopped = f"{error}. "
    raise OutOfLimitsError(f"pose {name}: the tip still did not sit after {MOST_NUDGES} steps")


def _rise(bench: Bench) -> None:
    _go(bench, bench.arm.state().base_T_tcp.translated(z_m=2 * ABOVE_M))


def _go(bench: Bench, target: Pose) -> None:
    go(bench, target, SPEED_M_S, acceleration_m_s2=ACCELERATION_M_S2, full_speed_s=MOTION_TIMEOUT_S)
