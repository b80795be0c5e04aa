"""Read a tactile sensor of a bench and estimate its angle in threads, for programs with their own loop."""

import logging
import threading
from contextlib import ExitStack
from itertools import islice

from drivers.bench import Fingertip
from drivers.clock import NS_PER_S, Clock
from drivers.errors import DeviceError, DeviceTimeoutError, InputError, NotConnectedError, StaleFrameError
from drivers.tally import new_pictures
from drivers.types import Frame
from rig.bench.source import unconnected_bench
from rig.config import load_bench
from rig.frames.streaming import StreamingEstimator
from rig.tactile.contact.background import mean_background
from rig.tactile.estimators import DEFAULT_ESTIMATOR, choose_estimator
from rig.tactile.sample import SlipSample, State

_log = logging.getLogger(__name__)
BACKGROUND_FRAMES = 10
"""Number of new pictures after connecting whose mean is the background."""
LATE_NS = NS_PER_S // 10
"""Age of a frame from which on older frames in the queue are skipped."""
FRAME_S, STOP_S = 2.0, 5.0
"""Longest wait for a frame, and for a thread to end."""


NO_ANGLE = SlipSample(0, State.NO_CONTACT, slip=False)
"""Before the first frame."""


class LiveFingertip:
    """A live tactile sensor of a bench file; no other device of the bench is connected.

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
        self._changed = threading.Condition()
        self._frame: Frame | None = None
        self._unread = False
        self._failure: DeviceError | None = None
        self._angle = NO_ANGLE

    @property
    def connected(self) -> bool:
        """Whether the sensor is connected."""
        return self._opened is not None

    def connect(self) -> None:
        """Connect the sensor. Nothing may touch the gel, because the first frames become the background.

        Raises `DeviceError` if the sensor cannot be opened, sends no frames or has frozen, `EstimatorError`.
        """
        self.disconnect()
        self._frame, self._unread, self._failure, self._angle = None, False, None, NO_ANGLE
        with ExitStack() as stack:
            bench = stack.enter_context(unconnected_bench(self._bench))
            tip = next(tip for tip in bench.fingertips if tip.finger == self._finger)
            self._clock: Clock = bench.clock
            stack.callback(tip.sensor.disconnect)
            tip.sensor.connect()
            tip.sensor.next_frame(FRAME_S)
            first = islice(new_pictures(tip.sensor, FRAME_S, FRAME_S), BACKGROUND_FRAMES)
            untouched = mean_background([frame.image for frame in first])
            stopping = threading.Event()
            work = [threading.Thread(target=self._read, args=(tip, stopping), daemon=True)]
            if self._choice is not None:
                self._choice.try_making()
                estimator = self._choice.make(untouched, sign=tip.sign)
                stream = StreamingEstimator(estimator, untouched.shape, tip.sign, each_contact=True)
                stream.check_background(untouched)
                work.append(threading.Thread(target=self._estimate, args=(stream, stopping), daemon=True))
            for thread in work:
                stack.callback(thread.join, STOP_S)
            stack.callback(stopping.set)
            for thread in work:
                thread.start()
            with self._changed:
                self._changed.wait_for(lambda: self._frame is not None or self._failure is not None, FRAME_S)
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
            if self._frame is None or self._clock.now_ns() - self._frame.time_ns > max_age_s * NS_PER_S:
                raise StaleFrameError(f"{self.serial}: no frame of the last {max_age_s:.3g} s")
            self._unread = False
            return self._frame

    def next(self, timeout_s: float) -> Frame:
        """Return the newest frame that was not returned before; wait for one if necessary.

        Raises `DeviceTimeoutError` if no frame arrives within `timeout_s`.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._unread or self._failure is not None, timeout_s)
            self._require_running()
            if self._frame is None or not self._unread:
                raise DeviceTimeoutError(f"{self.serial}: no new frame within {timeout_s:.3g} s")
            self._unread = False
            return self._frame

    def angle(self) -> SlipSample:
        """Return the newest angle since the contact has settled, with the fingertip's sign applied.

        Until then it counts from the first angle of the contact.
        """
        with self._changed:
            self._require_running()
            return self._angle

    def _require_running(self) -> None:
        """Raise `NotConnectedError` before `connect`, and the sensor's `DeviceError` after a failure."""
        if self._opened is None:
            raise NotConnectedError(f"{self.serial}: read before connect; connect the fingertip first")
        if self._failure is not None:
            raise self._failure

    def _read(self, tip: Fingertip, stopping: threading.Event) -> None:
        """Read frames until stopped or the sensor fails; if reading is late, skip queued frames."""
        while not stopping.is_set():
            try:
                frame = tip.sensor.next_frame(FRAME_S)
                if self._clock.now_ns() - frame.time_ns > LATE_NS:
                    frame = tip.sensor.newest_frame(FRAME_S)
            except DeviceError as error:
                with self._changed:
                    self._failure = error
                    self._changed.notify_all()
                return
            with self._changed:
                self._frame, self._unread = frame, True
                self._changed.notify_all()

    def _estimate(self, stream: StreamingEstimator, stopping: threading.Event) -> None:
        """Estimate from the newest frame until stopped; frames are left out if the estimator is slower."""
        done: Frame | None = None
        while not stopping.is_set():
            with self._changed:
                self._changed.wait_for(lambda done=done: self._frame is not done, FRAME_S / 10)
                frame = self._frame
            if frame is None or frame is done:
                continue
            done = frame
            sample = stream.update_at(frame.image, frame.time_ns)
            if stream.news:
                _log.warning("%s: %s", self.serial, stream.news)
            with self._changed:
                self._angle = sample
