"""Deliver the frames of all sensors to the observer, those of the fingertips in order of capture.

Also verify that the contacts disappear when the fingers open (`LEFT_SHARE`).
"""

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.bench import Bench
from drivers.clock import NS_PER_S, to_ns
from drivers.errors import (
    DeviceError,
    DeviceTimeoutError,
    FingerMotionError,
    ProtectiveStopError,
    StaleFrameError,
)
from drivers.images import with_jpeg
from drivers.interfaces import FrameSource
from drivers.tally import SELDOM_NS, PictureNews
from drivers.types import ArmMode, ArmState, Frame, GripperState, Image
from protocols.observer import LiftEvents

Imprint = NDArray[np.float32]
"""(H, 40, 3) fine structure of a tactile image: its logarithm, high-pass filtered with SMOOTH_PX."""

WIDTH_PX = 40
"""Width to which images are reduced before imprints are compared."""
SMOOTH_PX = 5.0
"""Sigma of the Gaussian whose output is subtracted, px of the reduced image."""
DARK = 10.0
"""Grey levels added before the logarithm, so that noise in dark pixels does not dominate."""
LEFT_SHARE = 0.6
"""Largest fraction of its imprint that may remain after a release. Measured on hard simulated lifts with
drifting light and gels that keep a print: at most 0.44 after 45 releases, at least 0.76 in 9 lifts whose
fingers did not open.

The contact detection that stops the closing compares a frame with one from before the grasp. After several
seconds of drifting light it may report contact on an untouched gel. A release is therefore verified with the
imprint of its contact: the fine structure that appeared with it must disappear when the fingers open."""


def imprint(image: Image) -> Imprint:
    """Return the fine structure of a tactile image, (H, W, 3) uint8 RGB."""
    size = (WIDTH_PX, max(1, round(image.shape[0] * WIDTH_PX / image.shape[1])))
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
    logarithm = np.log(small + DARK)
    return np.asarray(logarithm - cv2.GaussianBlur(logarithm, (0, 0), SMOOTH_PX), np.float32)


def share_left(untouched: Imprint, held: Imprint, now: Imprint) -> float:
    """Return the fraction of a contact's imprint that an image still shows: 1 all, 0 none (least squares).

    untouched: mean imprint of some frames before the grasp. held: imprint before the fingers opened. now:
    imprint of the image.
    """
    contact, rest = held - untouched, now - untouched
    energy = float(np.sum(contact * contact))
    return float(np.sum(rest * contact)) / energy if energy > 0.0 else 0.0


ArmLimit = Callable[[ArmState | None], float]
"""Returns the time limit of a motion of the arm, s, for its newest state."""
FRAME_TIMEOUT_S = 0.25
"""Time without a frame after which a source counts as silent."""
JITTER = 0.1
"""Largest fraction of its period that a frame may be early."""
CATCH_UP_S = 3.0
"""Extra time in which a loaded host may deliver late frames, s."""
PICTURE_S = 0.004
"""Least time before the next frame of a fingertip in which processing of a camera picture is started."""
NEWEST_FRAMES = 3
"""Frames per fingertip over which the contact strength is the median, so that one bad frame has no effect."""
UNTOUCHED_FRAMES = 8
"""First frames after the start, which show the gels untouched: closing the margin takes the fingers
longer."""
PATIENCE_S = 0.04
"""Age at which a camera picture is processed even if a fingertip's frame is due."""


class Pump:
    """Delivers the frames of all sources one by one.

    Frames of the fingertips are delivered in order of capture: a frame is held back while the other fingertip
    may still deliver an earlier one. Camera frames are delivered when no fingertip frame is ready or due,
    because the marker angle is not urgent, and the fingertips' angles must not wait for it. A single reader
    keeps the order, and so every result, the same in each run; the sources' backlogs hold the frames that
    arrive meanwhile.
    """

    def __init__(self, bench: Bench, observer: LiftEvents) -> None:
        self._bench = bench
        self._observer = observer
        self._tips = [_Stream(tip.sensor) for tip in bench.fingertips]
        self._camera = _Stream(bench.camera) if bench.has("camera") else None
        self._streams = [*self._tips, *((self._camera,) if self._camera else ())]
        self._still_m: tuple[float, float] | None = None
        self.arm: ArmState | None = None
        """Newest state of the arm, read with each camera picture; None before the first."""

    def expect_fingers(self, opening_m: tuple[float, float] | None) -> None:
        """Set the range of openings, m, that the last command allows; None while the fingers move.

        With each camera picture the gripper's opening is compared with it, because fingers that move without
        a command change the grip: the angle of such a lift shows the gripper, not the object.
        """
        self._still_m = opening_m

    def start(self) -> None:
        """Discard all frames captured before now."""
        self._bench.clock.sleep_until(self._bench.clock.now_ns() + to_ns(0.05))
        for stream in self._streams:
            stream.skip()

    @property
    def seen_ns(self) -> int:
        """The time up to which all frames of the fingertips have been delivered, at most now."""
        return min(self._bench.clock.now_ns(), *(tip.next_ns for tip in self._tips))

    def contacts(self) -> list[tuple[Imprint, Imprint]]:
        """Return the contact of each fingertip: the imprint of its first frames, and that of its newest."""
        return [(tip.untouched_imprint(), tip.newest_imprint()) for tip in self._tips]

    def contact_strength(self) -> float:
        """Return how strongly both gels are deformed now, compared with their first frames, as a norm."""
        return float(np.sqrt(sum(tip.contact_energy() for tip in self._tips)))

    def still_shown(self, contacts: Sequence[tuple[Imprint, Imprint]]) -> list[str]:
        """Return the serials of the fingertips that still show one of these contacts."""
        return [
            tip.source.serial
            for tip, (untouched, held) in zip(self._tips, contacts, strict=True)
            if share_left(untouched, held, tip.newest_imprint()) > LEFT_SHARE
        ]

    def run_for(self, duration_s: float, unless: Callable[[], bool] = lambda: False) -> bool:
        """Deliver all frames captured in the next `duration_s`; return after the last one is delivered.

        unless: ends the delivery earlier if true. Returns whether the full time has passed.
        """
        end = self._bench.clock.now_ns() + to_ns(duration_s)

        def over() -> bool:
            return min(s.next_ns for s in self._streams) >= end

        what = f"the frames of {duration_s:.3g} s were not processed"
        self.run_until(lambda: unless() or over(), duration_s + CATCH_UP_S, what)
        return not unless()

    def run_until(self, done: Callable[[], bool], limit: float | ArmLimit, missed: str) -> None:
        """Deliver frames until `done`. Raises `DeviceTimeoutError`, or the error of a source.

        limit: time limit, s. That of a motion of the arm is the largest one of all the arm's states since the
        call, because its speed slider may be moved in the meantime. missed: the failure to report after it,
        such as "the arm did not stop".
        """
        began_ns, limit_s = self._bench.clock.now_ns(), 0.0
        while not done():
            limit_s = max(limit_s, limit(self.arm)) if callable(limit) else limit
            if self._bench.clock.now_ns() > began_ns + to_ns(limit_s):
                raise DeviceTimeoutError(self._late(missed, limit_s))
            self._deliver(*self._next())

    def _late(self, missed: str, timeout_s: float) -> str:
        """Return the message about a missed time limit. Late frames show that the computer is overloaded."""
        late_s = (self._bench.clock.now_ns() - self.seen_ns) / NS_PER_S
        cure = "end other programs on it, or set a lower rate_hz of the sensors in the bench file"
        if late_s > FRAME_TIMEOUT_S:
            why = f"the fingertips' frames are {late_s:.2f} s late: the computer is overloaded; {cure}"
        else:
            why = f"check the devices; if the computer may be overloaded, {cure}"
        return f"bench: {missed} within {timeout_s:.3g} s; {why}, then start again"

    def _next(self) -> tuple[FrameSource, Frame]:
        """Return the fingertips' earliest frame, or a camera frame if that one has not arrived yet."""
        while True:
            now_ns = self._bench.clock.now_ns()
            for tip in self._tips:
                tip.poll(now_ns)
            first = min(self._tips, key=lambda tip: tip.next_ns)
            if first.waiting is not None:
                return first.source, first.take()
            if (camera := self._camera) is not None:
                now_ns = self._bench.clock.now_ns()
                camera.poll(now_ns)
                # if processing the picture delays no fingertip, or the picture has waited too long
                if camera.waiting is not None and (
                    first.next_ns - now_ns >= to_ns(PICTURE_S)
                    or not 0 <= now_ns - camera.waiting.time_ns < to_ns(PATIENCE_S)
                ):
                    return camera.source, camera.take()
                camera.check_alive(now_ns)
            first.fetch()

    def _deliver(self, source: FrameSource, frame: Frame) -> None:
        if source is self._bench.camera and self._bench.actuators:
            # Errors of the arm or the gripper are raised here, whatever the lift is waiting for.
            self.arm = state = self._bench.arm.state()
            require_running(state)
            self._observer.arm(state)
            fingers = self._bench.gripper.state()
            self._observer.gripper(fingers)
            self._require_still(fingers)
        self._observer.frame(frame)

    def _require_still(self, state: GripperState) -> None:
        """Raise `FingerMotionError` if the fingers have moved without a command.

        A driver that keeps the grip has closed them again (`Gripper.keep_grip`); otherwise they are stopped.
        """
        why = "another program commands the gripper, it lost its power, or its drive slips"
        if state.reclosed_from_m is not None:
            raise FingerMotionError(
                f"gripper: the fingers opened to {1e3 * state.reclosed_from_m:.1f} mm without a command, and "
                f"its driver closed them again: {why}. Check the gripper, then start again"
            )
        if self._still_m is None or self._still_m[0] <= state.opening_m <= self._still_m[1]:
            return
        low, high = self._still_m
        with suppress(DeviceError):  # fingers that still move would drop the object before it is set down
            self._bench.gripper.stop()
        moved = "opened" if state.opening_m > high else "closed"
        raise FingerMotionError(
            f"gripper: the fingers {moved} to {1e3 * state.opening_m:.1f} mm without a command (allowed: "
            f"{1e3 * low:.1f} to {1e3 * high:.1f} mm): {why}. Check the gripper, then start again"
        )


class _Stream:
    """One source: its frame that is ready to be delivered, and its statistics."""

    def __init__(self, source: FrameSource) -> None:
        self.source = source
        self.waiting: Frame | None = None
        self._earliest_ns = 0
        self._last: Frame | None = None
        self._news = PictureNews(SELDOM_NS)
        self._first: list[Imprint] = []
        self._newest: deque[Frame] = deque(maxlen=NEWEST_FRAMES)

    @property
    def next_ns(self) -> int:
        """Capture time of the next frame; if it has not arrived yet, the earliest possible one."""
        return self.waiting.time_ns if self.waiting is not None else self._earliest_ns

    def skip(self) -> None:
        """Discard all frames captured before now. Raises `StaleFrameError`."""
        self.waiting = None
        self._accept(with_jpeg(self.source.newest_frame(max_age_s=FRAME_TIMEOUT_S)))

    def poll(self, now_ns: int) -> None:
        """Fetch the next frame if it has arrived. Raises `StaleFrameError` if the sensor froze."""
        period_ns = NS_PER_S / self.source.rate_hz
        # It cannot have arrived less than a period after the last one, unless that one's time was wrong.
        early = 0 < self._earliest_ns - now_ns < period_ns
        if self.waiting is None and not early:
            with suppress(DeviceTimeoutError):
                self.fetch(0.0)

    def check_alive(self, now_ns: int) -> None:
        """Raise `StaleFrameError` if no frame has arrived for too long."""
        if now_ns - self._earliest_ns > to_ns(FRAME_TIMEOUT_S):
            self._accept(with_jpeg(self.source.newest_frame(FRAME_TIMEOUT_S)))
            self.waiting = self._last

    def fetch(self, timeout_s: float = FRAME_TIMEOUT_S) -> None:
        """Wait for the next frame. Raises `DeviceTimeoutError`, `StaleFrameError` if the sensor froze."""
        frame = with_jpeg(self.source.next_frame(timeout_s))
        self._accept(frame)
        self.waiting = frame

    def take(self) -> Frame:
        """Return the frame that is ready, and clear it."""
        frame, self.waiting = self.waiting, None
        if frame is None:
            raise StaleFrameError(f"{self.source.serial}: no frame is ready")
        self._newest.append(frame)
        if len(self._first) < UNTOUCHED_FRAMES:
            self._first.append(imprint(frame.image))
        return frame

    def newest_imprint(self) -> Imprint:
        """Return the fine structure of the newest delivered frame. Raises `StaleFrameError`."""
        if not self._newest:
            raise StaleFrameError(f"{self.source.serial}: no frame was delivered yet")
        return imprint(self._newest[-1].image)

    def contact_energy(self) -> float:
        """Return the median energy of the newest frames' imprint relative to the untouched gel."""
        untouched = self.untouched_imprint()
        return float(np.median([np.sum((imprint(f.image) - untouched) ** 2) for f in self._newest]))

    def untouched_imprint(self) -> Imprint:
        """Return the mean fine structure of the first delivered frames."""
        return np.mean(self._first, axis=0)

    def _accept(self, frame: Frame) -> None:
        if frame.serial != self.source.serial:
            raise DeviceError(
                f"{self.source.serial}: it delivers frames of {frame.serial}: the sensors were exchanged; "
                "check their cables and the bench file, then start again"
            )
        self._news.add(frame.image, frame.time_ns)
        self._news.require_live(self.source.serial)
        self._last = frame
        self._earliest_ns = frame.time_ns + round((1.0 - JITTER) * NS_PER_S / self.source.rate_hz)


def require_running(state: ArmState) -> None:
    """Raise `ProtectiveStopError` or `DeviceError` if the arm's safety system has stopped it."""
    if state.mode is ArmMode.RUNNING:
        return
    kind = ProtectiveStopError if state.mode is ArmMode.PROTECTIVE_STOP else DeviceError
    raise kind(
        f"arm: its safety system reports '{state.mode.value}'; inspect arm and pendant, clear the cause"
    )
