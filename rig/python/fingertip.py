"""Read a tactile sensor of a bench and estimate its angle in threads, for programs with their own loop."""

import logging
import threading
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any

from drivers.clock import NS_PER_S, Clock
from drivers.errors import (
    DeviceError,
    DeviceTimeoutError,
    InputError,
    NotConnectedError,
    RigError,
    StaleFrameError,
)
from drivers.tally import new_pictures
from drivers.types import Frame
from rig.bench.source import unconnected_bench
from rig.config import load_bench
from rig.live.desk_sensor import DeskSensor, Streams
from rig.tactile.contact.background_check import TAKE_AGAIN
from rig.tactile.estimators import DEFAULT_ESTIMATOR, choose_estimator
from rig.tactile.sample import SlipSample, State

_log = logging.getLogger(__name__)
FRAME_S, STOP_S = 2.0, 5.0
"""Longest wait for the first frames, and for the thread to end."""
WAIT_S = 0.1
"""Interval at which the thread checks whether it has to end."""


NO_ANGLE = SlipSample(0, State.NO_CONTACT, slip=False)
"""Before the first estimate."""


@dataclass(frozen=True, slots=True)
class _Newest:
    """The newest frame and angle. unread: whether `next` has not returned the frame yet.

    failure: why there are no frames; None while they arrive.
    """

    frame: Frame | None = None
    unread: bool = False
    failure: RigError | None = None
    angle: SlipSample = NO_ANGLE


class LiveFingertip:
    """A live tactile sensor of a bench file; no other device of the bench is connected.

    Each frame is estimated after it was read. If this takes too long, frames older than 0.3 s are skipped.

    bench: as for `--bench`. finger: name as in the bench file. estimator: a name; None for frames without
    angles. Raises `InputError` for an invalid bench, estimator or finger.
    """

    def __init__(self, bench: str, finger: str, estimator: str | None = DEFAULT_ESTIMATOR) -> None:
        self._bench = load_bench(bench)
        sensors = {sensor.finger: sensor for sensor in self._bench.tactile}
        if finger not in sensors:
            raise InputError(
                f"bench '{bench}' has no sensor on finger '{finger}', only on {', '.join(sensors)}"
            )
        self.serial, self.rate_hz = sensors[finger].serial, sensors[finger].rate_hz
        self.size_px = sensors[finger].size_px
        self._finger = finger
        self._choice = None if estimator is None else choose_estimator(estimator, window=1)
        self._opened: ExitStack | None = None
        self._changed, self._newest = threading.Condition(), _Newest()

    @property
    def is_connected(self) -> bool:
        """Whether the sensor is connected."""
        return self._opened is not None

    def connect(self) -> None:
        """Connect the sensor. Nothing may touch the gel, because the first frames become the background.

        Raises `DeviceError` if the sensor cannot be opened, sends no frames or has frozen, `EstimatorError`.
        """
        self.disconnect()
        self._newest = _Newest()
        with ExitStack() as stack:
            bench = stack.enter_context(unconnected_bench(self._bench))
            tip = next(tip for tip in bench.fingertips if tip.finger == self._finger)
            self._clock: Clock = bench.clock
            sensor = None
            if self._choice is not None:
                self._choice.try_making()
                sensor = DeskSensor(self.serial, self._choice, tip.sign, None, None, remedy=TAKE_AGAIN)
            stack.callback(tip.sensor.disconnect)
            tip.sensor.connect()
            tip.sensor.next_frame(FRAME_S)
            next(new_pictures(tip.sensor, FRAME_S, FRAME_S))  # fails if the sensor has frozen
            streams, stopping = Streams([tip.sensor], self._clock), threading.Event()
            thread = threading.Thread(target=self._work, args=(streams, sensor, stopping), daemon=True)
            stack.callback(streams.close)
            streams.start()
            stack.callback(thread.join, STOP_S)
            stack.callback(stopping.set)
            thread.start()
            with self._changed:
                self._changed.wait_for(
                    lambda: (
                        self._newest.failure
                        or (self._newest.frame and (sensor is None or sensor.background.image is not None))
                    )
                )
                if self._newest.failure is not None:
                    raise self._newest.failure
            self._opened = stack.pop_all()

    def disconnect(self) -> None:
        """Stop reading and disconnect the sensor. May be called repeatedly."""
        opened, self._opened = self._opened, None
        if opened is not None:
            opened.close()

    def newest(self, max_age_s: float) -> Frame:
        """Return the newest frame, also if it was returned before.

        Raises `StaleFrameError` if it is older than `max_age_s`.
        """
        with self._changed:
            self._require_running()
            frame = self._newest.frame
            if frame is None or self._clock.now_ns() - frame.time_ns > max_age_s * NS_PER_S:
                raise StaleFrameError(f"{self.serial}: no frame of the last {max_age_s:.3g} s")
            self._newest = replace(self._newest, unread=False)
            return frame

    def next(self, timeout_s: float) -> Frame:
        """Return the newest frame that was not returned before; wait for one if necessary.

        Raises `DeviceTimeoutError` if no frame arrives within `timeout_s`.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._newest.unread or self._newest.failure, timeout_s)
            self._require_running()
            newest, self._newest = self._newest, replace(self._newest, unread=False)
            if newest.frame is None or not newest.unread:
                raise DeviceTimeoutError(f"{self.serial}: no new frame within {timeout_s:.3g} s")
            return newest.frame

    def angle(self) -> SlipSample:
        """Return the newest angle since the contact has settled, with the fingertip's sign applied.

        Until then it counts from the first angle of the contact.
        """
        with self._changed:
            self._require_running()
            return self._newest.angle

    def _require_running(self) -> None:
        """Raise `NotConnectedError` before `connect`, and the failure while no frames arrive."""
        if self._opened is None:
            raise NotConnectedError(f"{self.serial}: read before connect; connect the fingertip first")
        if self._newest.failure is not None:
            raise self._newest.failure

    def _work(self, streams: Streams, sensor: DeskSensor | None, stopping: threading.Event) -> None:
        """Read frames, and estimate each, until stopped or the sensor fails; runs in a separate thread."""
        while not stopping.is_set() and not streams.has_ended:
            arrived = streams.next(WAIT_S)
            if arrived is None:
                continue
            frame = arrived[1]
            if isinstance(frame, DeviceError):
                self._set(failure=frame)
                continue
            self._set(frame=frame, unread=True, failure=None)
            if sensor is not None:
                try:
                    self._set(angle=self._estimate(sensor, frame))
                except RigError as error:
                    self._set(failure=error)
                    return

    def _estimate(self, sensor: DeskSensor, frame: Frame) -> SlipSample:
        """Return the angle in a frame, and log news about background and sensor. Raises `RigError`."""
        sample = sensor.take(frame, self._clock).sample or NO_ANGLE
        if sensor.news:
            doubtful = sensor.background.doubt or sample.state is State.FROZEN
            _log.log(logging.WARNING if doubtful else logging.INFO, "%s: %s", self.serial, sensor.news)
        return sample

    def _set(self, **values: Any) -> None:
        """Change the newest values, and wake up those that wait for them."""
        with self._changed:
            self._newest = replace(self._newest, **values)
            self._changed.notify_all()
