"""Capture samples for a hand-eye calibration: move, wait until the arm is still, store pose and picture.

Also pictures of something at rest, for other calibrations.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice

from drivers.bench import Bench
from drivers.clock import to_ns
from drivers.errors import DeviceTimeoutError, OutOfLimitsError
from drivers.interfaces import FrameSource
from drivers.tally import new_pictures
from drivers.types import Frame, Pose
from protocols.steps import arm_limit_s

SPEED_M_S = 0.15
ACCELERATION_M_S2 = 0.5
"""Speed and acceleration between the poses."""
MOTION_TIMEOUT_S = 20.0
"""Time limit of a motion between two poses at full speed."""
SETTLE_S = 0.4
"""The arm counts as still if its pose does not change over this time."""
STILL_TIMEOUT_S = 4.0
"""Time limit for the arm to come to rest."""
_STILL_M = 2.5e-4
_STILL_RAD = 5e-4
"""Largest change of the pose during `SETTLE_S`, m and rad: above the noise of an arm at rest.

Encoders with a noise of 3e-5 rad make two readings differ by up to 0.18 mm and 0.31 mrad (simulated, 9,000
pairs at a reach of 0.83 m)."""
FRAME_TIMEOUT_S = 1.0
"""Time limit for the next frame."""
_FRAME_AGE_S = 1.0
"""If the newest frame is older, the stream has stopped. The stored frame is captured after this check."""
_MOST_EARLIER = 300
"""Most frames from before the standstill that are skipped: several seconds of frames."""


@dataclass(frozen=True, slots=True)
class HandEyeCapture:
    """One sample: the arm's pose at the time of the picture, and the picture.

    id: of both, so that pose and picture cannot be paired wrongly.
    """

    id: str
    base_T_tcp: Pose  # noqa: N815 - frame names keep their case
    frame: Frame


NextPose = Callable[[], tuple[str, Pose] | None]
"""Returns the next pose to visit with its id; None when there are enough."""


def capture_hand_eye(
    bench: Bench,
    next_pose: NextPose,
    keep: Callable[[HandEyeCapture], None],
    skipped: Callable[[str, str], None],
) -> None:
    """Visit poses one after the other.

    keep: receives each sample. skipped: receives the id and the reason of a pose without a sample. A pose
    beyond the arm's limits is skipped before anything moves. On any other error, and on a stop, the arm stops
    where it is and the error is raised; the hand holds nothing that could fall.
    """
    try:
        while (target := next_pose()) is not None:
            name, pose = target
            limit_s = arm_limit_s(MOTION_TIMEOUT_S, bench.arm.state())
            try:
                motion = bench.arm.move_linear(pose, SPEED_M_S, ACCELERATION_M_S2)
            except OutOfLimitsError as error:
                skipped(name, str(error))
                continue
            motion.wait(limit_s)
            wait_until_still(bench)
            # a picture captured after the standstill, between two readings of the arm that agree
            before = bench.arm.state().base_T_tcp
            frame = _captured_since(bench, bench.clock.now_ns())
            after = bench.arm.state().base_T_tcp
            if not before.is_near(after, _STILL_M, _STILL_RAD):
                raise DeviceTimeoutError(
                    f"arm: moved while picture {name} was taken; is a person guiding it?"
                )
            keep(HandEyeCapture(name, after, frame))
    except BaseException:
        bench.arm.stop()
        raise


def wait_until_still(bench: Bench) -> None:
    """Wait until the arm, if there is one, has stood still for 0.4 s.

    Raises `DeviceTimeoutError` after 4 s.
    """
    if not bench.has("arm"):
        bench.clock.sleep_until(bench.clock.now_ns() + to_ns(SETTLE_S))
        return
    deadline = bench.clock.now_ns() + to_ns(STILL_TIMEOUT_S)
    before = bench.arm.state().base_T_tcp
    while bench.clock.now_ns() < deadline:
        bench.clock.sleep_until(bench.clock.now_ns() + to_ns(SETTLE_S))
        now = bench.arm.state().base_T_tcp
        if before.is_near(now, _STILL_M, _STILL_RAD):
            return
        before = now
    raise DeviceTimeoutError(
        f"arm: still moving {STILL_TIMEOUT_S:.0f} s after it arrived; check its payload and mounting"
    )


def _captured_since(bench: Bench, time_ns: int) -> Frame:
    """Return the first new picture captured at `time_ns` or later: an earlier one may show the arm moving.

    Raises `DeviceTimeoutError` if all frame times stay before `time_ns`, `StaleFrameError` if the camera has
    stopped or frozen.
    """
    for frame in islice(new_pictures(bench.camera, _FRAME_AGE_S, FRAME_TIMEOUT_S), _MOST_EARLIER):
        if frame.time_ns >= time_ns:
            return frame
    raise DeviceTimeoutError(
        f"{bench.camera.serial}: {_MOST_EARLIER} frames from before the arm stood still; is its clock right?"
    )


FRAME_AGE_S = 0.25
"""Largest age of the newest frame before the capture starts; an older one means a stopped stream."""


def capture_still(
    bench: Bench, source: FrameSource, count: int, shown: Callable[[Frame], None] | None = None
) -> list[Frame]:
    """Capture `count` new pictures of a source after the arm has come to rest; moves nothing.

    shown: called with each frame. Raises `DeviceTimeoutError` if the arm does not come to rest or a frame is
    late, `StaleFrameError` if the source has stopped or frozen.
    """
    wait_until_still(bench)
    frames = []
    for frame in islice(new_pictures(source, FRAME_AGE_S, FRAME_TIMEOUT_S), count):
        frames.append(frame)
        if shown is not None:
            shown(frame)
    return frames
