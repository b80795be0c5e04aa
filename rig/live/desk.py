"""One or two sensors on a desk: a live angle without a bench.

One thread per sensor waits for its frames; one thread estimates, records and sends to viewers. Nothing here
moves hardware.
"""

import queue
import threading
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

from drivers.clock import NS_PER_S, Clock, SystemClock, to_ns
from drivers.errors import (
    DeviceError,
    DeviceTimeoutError,
    InputError,
    RecordingError,
    RigError,
    StaleFrameError,
    counted,
)
from drivers.interfaces import FrameSource
from drivers.types import Frame, Image
from rig.frames.estimation import require_frames_suffice
from rig.frames.streaming import AngleSample
from rig.lift.fusion import FusedAngles, FusedSample
from rig.live.actions import ESTIMATOR, RECORD, REFERENCE, TAKE_BACKGROUND
from rig.live.clip_writer import ClipWriter, clip_folder
from rig.live.desk_sensor import DeskSensor, Reading
from rig.live.feed import OBJECT, Sender
from rig.live.observer import PICTURE_LONG_SIDE_PX, small_jpeg
from rig.tactile.estimators import ESTIMATORS, EstimatorChoice, choose_estimator
from rig.tactile.sample import SlipSample, State

LATEST_S = 0.3
"""Frames that wait longer are skipped and counted as dropped, so that the angle is never late."""
FRAME_TIMEOUT_S = 1.0
NO_REFERENCE = "no reference yet"
"""State of the object while its sensors track a contact that has no reference."""


@dataclass(frozen=True, slots=True)
class DeskSettings:
    """Settings of a desk.

    signs: factor from each sensor's image angle to the object angle, +1 or -1. background, aspect: see
    `DeskSensor`. clips: folder in which clips are recorded. serials: of the sensors, in the order of the
    sources; None for a source without one. simulated: whether a source is simulated. estimators: names that
    the user can choose from; others are refused, because a foreign name would be imported.
    """

    choice: EstimatorChoice
    signs: tuple[int, ...] = (1, -1)
    background: Image | None = None
    aspect: float | None = None
    clips: Path = Path("clips")
    serials: tuple[str | None, ...] = (None, None)
    simulated: bool = False
    estimators: tuple[str, ...] = ESTIMATORS


class Desk:
    """Sensors on a desk, from `start` to `close`. A context manager.

    sources: one or two, not connected. sender: sends to viewers. Raises `DeviceError` if a source cannot be
    opened.
    """

    def __init__(
        self,
        sources: Sequence[FrameSource],
        settings: DeskSettings,
        sender: Sender,
        clock: Clock | None = None,
    ) -> None:
        if len(sources) > 1 and OBJECT in (source.serial for source in sources):
            raise InputError(f"source '{OBJECT}': this name is that of both sensors' angle: rename it")
        self._sources, self._settings, self._sender = sources, settings, sender
        self._clock = clock or SystemClock()
        self.sensors = {
            source.serial: DeskSensor(
                source.serial, settings.choice, sign, settings.background, settings.aspect, serial
            )
            for source, sign, serial in zip(sources, settings.signs, settings.serials, strict=False)
        }
        self.notice = ""
        self.fault: str | None = None
        """First error of a user-defined estimator."""
        self._frames: queue.Queue[tuple[str, Frame | DeviceError]] = queue.Queue(maxsize=len(sources))
        self._stopping = threading.Event()
        self._threads = [threading.Thread(target=self._wait, args=(s,), daemon=True) for s in sources]
        self._open = len(sources)
        self._fusion, self._zeros = FusedAngles(), list[SlipSample | None]()

    def __enter__(self) -> "Desk":
        self._settings.choice.try_making()  # takes seconds the first time, so do it before the first frame
        with_frames: list[FrameSource] = []
        try:
            for source in self._sources:
                source.connect()
                with_frames.append(source)
        except RigError:
            for source in with_frames:
                source.disconnect()
            raise
        for thread in self._threads:
            thread.start()
        if self._settings.background is None:
            self._say("taking the background: nothing may touch the gel")
        return self

    def __exit__(self, *_: object) -> None:
        self._stopping.set()
        for source in self._sources:
            source.disconnect()
        for thread in self._threads:
            while thread.is_alive():
                with suppress(queue.Empty):
                    self._frames.get_nowait()
                thread.join(0.01)
        self._end_clips()

    @property
    def ended(self) -> bool:
        """Whether all sources have ended, as files do."""
        return self._open == 0

    @property
    def recording(self) -> bool:
        """Whether a clip is being recorded."""
        return any(sensor.clip is not None for sensor in self.sensors.values())

    def step(self, timeout_s: float = 0.1) -> list[Reading]:
        """Process the next frame of any sensor; return its reading and, with two sensors, that of the object.

        The list is empty if no frame arrived in time or a source ended, see `ended`. Raises `DeviceError` if
        a sensor fails.
        """
        try:
            name, frame = self._frames.get(timeout=timeout_s)
        except queue.Empty:
            return []
        if isinstance(frame, DeviceError):
            self._open -= not isinstance(frame, DeviceTimeoutError)
            self._say(f"{frame}; {self.sensors[name].summary}")
            return []
        sensor = self.sensors[name]
        if sensor.clip is not None:
            self._record(sensor.clip, frame)
        reading = sensor.take(frame, self._clock)
        if sensor.news:
            self._say(f"{name}: {sensor.news}")
        if self.fault is None and reading.sample is not None and reading.sample.fault is not None:
            self.fault = reading.sample.fault
            self._say(f"the estimator failed; the state is then 'lost': {self.fault}")
        self._show(reading)
        fused = self._fused(reading)
        if fused is None:
            return [reading]
        self._show(fused)
        return [reading, fused]

    def act(self, text: str) -> None:
        """Carry out an action of the user, see `rig.live.actions`; `notice` then has the result or error."""
        try:
            self._say(self._done(text))
        except RigError as error:
            self._say(str(error))

    def _done(self, text: str) -> str:
        what, _, name = text.partition(" ")
        sensors = self.sensors.values()
        if what == REFERENCE:
            for sensor in sensors:
                sensor.set_reference()
            return "reference taken: the angle counts from here"
        if what == TAKE_BACKGROUND:
            for sensor in sensors:
                sensor.take_background()
            return "taking the background: nothing may touch the gel"
        if what == ESTIMATOR and name in self._settings.estimators:
            choice = replace(choose_estimator(name), gel=self._settings.choice.gel)
            require_frames_suffice(choice)
            made = [sensor.made(choice) for sensor in sensors]  # for all sensors before one changes
            for sensor, stream in zip(sensors, made, strict=True):
                sensor.choose(choice, stream)
            return f"estimator {name}"
        if what == RECORD:
            return self._end_clips() if self.recording else self._begin_clips()
        raise InputError(f"'{text}' is not known: reload the page")

    def _begin_clips(self) -> str:
        for name, sensor in self.sensors.items():
            background = sensor.background
            if background.image is None or background.collecting:
                raise InputError("record: wait until the background is taken")
            about = {"sensor": name, "simulated": self._settings.simulated, "background": background.origin}
            sensor.clip = ClipWriter(clip_folder(self._settings.clips, name), background.image, about)
        return f"recording to {', '.join(str(s.clip.folder) for s in self.sensors.values() if s.clip)}"

    def _record(self, clip: ClipWriter, frame: Frame) -> None:
        """Write a frame to a clip; if that fails, end the clips and go on."""
        try:
            clip.add(frame)
        except RecordingError as error:
            self._say(f"{error}; {self._end_clips()}")

    def _end_clips(self) -> str:
        done = []
        for sensor in self.sensors.values():
            if sensor.clip is not None:
                sensor.clip.close()
                done.append(f"{sensor.clip.folder}: {counted(sensor.clip.count, 'frame')}")
                sensor.clip = None
        return f"recorded {'; '.join(done)}"

    def _fused(self, now: Reading) -> Reading | None:
        """Return the object's angle at a sensor's newest frame; None with one sensor."""
        if len(self.sensors) < 2 or now.sample is None:
            return None
        streams = {n: s.stream for n, s in self.sensors.items() if s.stream is not None}
        tracks = {n: stream.track for n, stream in streams.items() if stream.track.samples}
        slip = any(sensor.slip for sensor in self.sensors.values())
        others = [track.newest() for n, track in tracks.items() if n != now.name]
        zeros = [track.zero_sample for track in tracks.values()]
        if zeros != self._zeros:
            self._zeros = zeros
            self._fusion.restart()
        fused = self._fusion.update(tracks[now.name].newest(), others)
        waits = fused.angle_deg is None and fused.state is State.TRACKING
        return Reading(
            OBJECT,
            now.time_ns,
            fused.disagreement or (NO_REFERENCE if waits else fused.state.value),
            _as_sample(fused, now.sample.time_s, slip),
            now.fps,
            (self._clock.now_ns() - now.time_ns) / NS_PER_S,
            sum(sensor.dropped for sensor in self.sensors.values()),
            max((zero.time_ns / NS_PER_S for t in tracks.values() if (zero := t.zero_sample)), default=None),
            slips_s=tuple(sorted(time_s for stream in streams.values() for time_s in stream.slips_s)),
        )

    def _show(self, reading: Reading) -> None:
        frame = reading.frame
        values = {"recording": self.recording, **reading.values()}
        if frame is None:
            self._sender.send("sensor", values)
            return
        scale, jpeg = 1.0, frame.jpeg or b""
        if not jpeg or max(frame.image.shape[:2]) > PICTURE_LONG_SIDE_PX:
            jpeg, scale = small_jpeg(frame.image)
        # OpenCV's coordinates are 0 at the centre of the first pixel, a browser's at its corner
        outline = ((reading.outline + 0.5) * scale).round(1).tolist()
        self._sender.send("sensor", {**values, "outline": outline}, jpeg)

    def _say(self, notice: str) -> None:
        self.notice = notice
        self._sender.send("notice", {"text": notice})

    def _wait(self, source: FrameSource) -> None:
        """Pass on a source's frames until it ends or the desk is closed; runs in a separate thread."""
        while not self._stopping.is_set():
            try:
                frame = source.next_frame(FRAME_TIMEOUT_S)
                if not source.waits and self._clock.now_ns() - frame.time_ns > to_ns(LATEST_S):
                    frame = source.newest_frame(FRAME_TIMEOUT_S)
            except StaleFrameError:
                continue
            except DeviceError as error:
                self._frames.put((source.serial, error))
                if not isinstance(error, DeviceTimeoutError):  # after that the source is opened again
                    return
            else:
                self._frames.put((source.serial, frame))


def _as_sample(fused: FusedSample, time_s: float, slip: bool) -> AngleSample:
    return AngleSample(
        time_s, fused.angle_deg, fused.sigma_deg, fused.state.value, fused.rate_deg_s, None, 0.0, slip
    )
