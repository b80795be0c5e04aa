"""One or two sensors on a desk: a live angle without a bench.

One thread per sensor waits for its frames; one thread estimates, records and sends to viewers. Nothing here
moves hardware.
"""

import queue
import threading
from collections import Counter, deque
from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

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
from drivers.realtime import ordinary
from drivers.tally import FrameTally
from drivers.types import Frame, Image
from rig.frames.estimates import require_frames_suffice
from rig.frames.streaming import StreamingEstimator
from rig.lift.object_angle import FusedAngles
from rig.live.clip_writer import SAVED_S, ClipWriter, NewestFrames, clip_folder
from rig.live.feed import (
    ESTIMATOR,
    MARK,
    NO_FRAMES,
    OBJECT,
    RECORD,
    REFERENCE,
    SAVE,
    TAKE_BACKGROUND,
    Sender,
)
from rig.live.observer import PICTURE_LONG_SIDE_PX, small_jpeg
from rig.live.sensor_background import SensorBackground
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.estimators import ESTIMATORS, EstimatorChoice, choose_estimator
from rig.tactile.sample import SlipSample, State, check_frame

LATEST_S = 0.3
"""Frames that wait longer are skipped and counted as dropped, so that the angle is never late."""
FRAME_TIMEOUT_S = 1.0
"""Time without a frame after which a sensor is reported, unless two of its frames take longer."""
NO_REFERENCE = "no reference yet"
"""State of the object while its sensors track a contact that has no reference."""
OUTLINE_EVERY_S = 0.05
OUTLINE_STEP = 4
"""The points of an outline are 1 px apart; every 4th point is shown."""
TAKING_BACKGROUND = "taking the background"
"""State while the background is taken."""
PREPARING = "preparing the estimator"
"""State after that, while the loops of the estimator are compiled."""
RATE_FRAMES = 61
"""Number of frames for the computation of the frame rate: one second of a DIGIT."""
KEPT_MARKS = 300
SAVE_PAUSE_S, SAVE_PAUSES, LATE_S = 0.003, 20, 0.05
"""Pause after each frame that is saved; it is repeated at most so often while estimates are later than
`LATE_S`. Without pauses, saving 30 s of two simulated sensors on a loaded host dropped 57 frames."""


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """The result for one frame of a sensor, or the fused angle of the object.

    sample: None while the background is taken or the estimator is prepared, and if no frames arrive. fps:
    frame rate from capture times, None at first and if no frames arrive. latency_s: time from capture to the
    angle. dropped: number of lost or skipped frames. zero_s: time of the frame whose angle is 0, None without
    a reference. background: its origin. doubt: why the background is doubtful, else empty. outline: of the
    contact, (N, 2) px, x right and y down. frame: None for the object, and if no frames arrive. slips_s:
    capture times at which the slip alarm was raised, s.
    """

    name: str
    time_ns: int
    state: str
    sample: SlipSample | None = None
    fps: float | None = None
    latency_s: float = 0.0
    dropped: int = 0
    zero_s: float | None = None
    background: str = ""
    doubt: str = ""
    outline: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 2), np.float32))
    frame: Frame | None = None
    slips_s: tuple[float, ...] = ()

    def line(self) -> str:
        sample, angle = self.sample, "angle     -    "
        if sample is not None and sample.angle_deg is not None:
            sigma = "" if sample.sigma_deg is None else f" +- {sample.sigma_deg:.1f}"
            angle = f"angle {sample.angle_deg:+6.1f}{sigma} deg"
        rate = "" if sample is None or sample.rate_deg_s is None else f", {sample.rate_deg_s:+.1f} deg/s"
        slip = "  SLIP" if sample is not None and sample.slip else ""
        if self.slips_s and not slip:
            slip = f", last slip {self.time_ns / NS_PER_S - self.slips_s[-1]:.1f} s ago"
        fps = "-" if self.fps is None else f"{self.fps:.0f}"
        return (
            f"{self.name}: {angle}{rate}, {self.state}{slip}; {fps} frames/s, {self.dropped} dropped, "
            f"{1e3 * self.latency_s:.0f} ms"
        )

    def values(self) -> dict[str, object]:
        sample = self.sample
        return {
            "sensor": self.name,
            "t_s": self.time_ns / NS_PER_S,
            "state": self.state,
            "angle_deg": sample and sample.angle_deg,
            "sigma_deg": sample and sample.sigma_deg,
            "rate_deg_s": sample and sample.rate_deg_s,
            "slip": bool(sample and sample.slip),
            "slips_s": self.slips_s,
            "fps": None if self.fps is None else round(self.fps, 1),
            "latency_ms": round(1e3 * self.latency_s, 2),
            "dropped": self.dropped,
            "zero_s": self.zero_s,
            "background": self.background,
            "doubt": self.doubt,
        }


class DeskSensor:
    """One sensor: its background, estimator and clip.

    sign: factor from the image angle to the object angle. background: None to take it from the first frames.
    aspect: width over height of a pixel on the gel, if known. serial: under which its background is stored;
    None for a source without a serial.
    """

    def __init__(
        self,
        name: str,
        choice: EstimatorChoice,
        sign: int,
        background: Image | None,
        aspect: float | None,
        serial: str | None = None,
    ) -> None:
        self.name = name
        self.stream: StreamingEstimator | None = None
        self.clip: ClipWriter | None = None
        self.newest = NewestFrames()
        self.background = SensorBackground(background, serial)
        self.news = ""
        """News about the background, or that the sensor has frozen, in the newest frame, for the user."""
        self.slip = False
        """Whether the slip alarm was on at the newest frame; False if no frames arrive."""
        self.reading: Reading | None = None
        """That of the newest frame; None if no frames arrive."""
        self.prepared: Callable[[], bool] = lambda: True
        """Whether the estimator can be made without a wait for its loops."""
        self._choice, self._sign, self._aspect = choice, sign, aspect
        self._tally, self._times = FrameTally(), deque[int](maxlen=RATE_FRAMES)
        self._states: Counter[str] = Counter()
        self._answered = 0
        self._finder: ContactFinder | None = None
        self._outline = np.empty((0, 2), np.float32)
        self._outlined_ns = 0

    @property
    def summary(self) -> str:
        """The number of frames, of those with an angle, and of those without by their state."""
        states = ", ".join(f"{count} {state}" for state, count in sorted(self._states.items()))
        without = states.replace("_", " ") or "none"
        return (
            f"{self._answered} of {counted(self._tally.frames, 'frame')} with an angle; "
            f"without: {without}; {self.dropped} dropped"
        )

    @property
    def dropped(self) -> int:
        return self._tally.dropped

    def take(self, frame: Frame, clock: Clock) -> Reading:
        """Estimate the angle in a frame. Raises `InputError`."""
        self._tally.add(frame)
        self._times.append(frame.time_ns)
        sample, state = None, TAKING_BACKGROUND
        if not self.background.collecting and self.stream is None and not self.prepared():
            state = PREPARING
        elif not self.background.collecting:
            sample = self._estimated(frame)
            state, self.slip = sample.state.value, bool(sample.slip)
        self.news = self.background.add(frame) or (self.stream.news if self.stream is not None else "")
        if sample is None or sample.angle_deg is None:
            self._states[state] += 1
        else:
            self._answered += 1
        late_s = (clock.now_ns() - frame.time_ns) / NS_PER_S
        span_s = (self._times[-1] - self._times[0]) / NS_PER_S
        fps = (len(self._times) - 1) / span_s if span_s > 0 else None
        zero = None if self.stream is None else self.stream.track.zero_sample
        zero_s = None if zero is None else zero.time_ns / NS_PER_S
        slips_s = () if self.stream is None else self.stream.slips_s
        origin, doubt = self.background.origin, self.background.doubt
        figures = (fps, late_s, self.dropped, zero_s, origin, doubt, self._outline, frame, slips_s)
        self.reading = Reading(self.name, frame.time_ns, state, sample, *figures)
        return self.reading

    def made(self, choice: EstimatorChoice) -> StreamingEstimator | None:
        """Make an estimator for this sensor, to `choose` it; return None while the background is taken.

        Raises `EstimatorError` or `InputError` if it cannot be made.
        """
        background = self.background.image
        if background is None or self.background.collecting:
            choice.try_making()
            return None
        return self._made(choice, background)

    def choose(self, choice: EstimatorChoice, stream: StreamingEstimator | None) -> None:
        """Change the estimator; the reference is set again when the contact has settled.

        stream: from `made`.
        """
        self._choice, self.stream = choice, stream

    def take_background(self) -> None:
        self.background.take()
        self.stream = self._finder = None
        self._outline = self._outline[:0]

    def set_reference(self) -> None:
        """Set the reference now. Raises `InputError` without a contact."""
        if self.stream is None:
            raise InputError("reference: wait until the background is taken")
        self.stream.set_reference()

    def _estimated(self, frame: Frame) -> SlipSample:
        background = frame.image if self.background.image is None else self.background.image
        if self._finder is None:
            check_frame(frame.image, background.shape)
            self._finder = ContactFinder(background)
        self.stream = self.stream or self._made(self._choice, background)
        self.stream.misfit = self.background.misfit
        sample = self.stream.update_at(frame.image, frame.time_ns)
        if sample.state == State.NO_CONTACT:
            self._outline = self._outline[:0]
        elif frame.time_ns - self._outlined_ns >= to_ns(OUTLINE_EVERY_S):
            self._outlined_ns = frame.time_ns
            self._outline = self._finder.find(frame.image).contour.reshape(-1, 2)[::OUTLINE_STEP]
        return sample

    def _made(self, choice: EstimatorChoice, background: Image) -> StreamingEstimator:
        estimator = choice.make(background, self._aspect, self._sign)
        return StreamingEstimator(estimator, background.shape, self._sign, each_contact=True)


@dataclass(frozen=True, slots=True)
class DeskSettings:
    """Settings of a desk.

    signs: factor from each sensor's image angle to the object angle, +1 or -1. backgrounds: of the sensors,
    in the order of the sources; None to take one from the first frames. aspect: see `DeskSensor`. clips:
    folder in which clips are recorded. serials: of the sensors, in the order of the sources; None for a
    source without one. simulated: whether a source is simulated. estimators: names that the user can choose
    from; others are refused, because a foreign name would be imported.
    """

    choice: EstimatorChoice
    signs: tuple[int, ...] = (1, -1)
    backgrounds: tuple[Image | None, ...] = (None, None)
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
                source.serial, settings.choice, sign, background, settings.aspect, serial
            )
            for source, sign, background, serial in zip(
                sources, settings.signs, settings.backgrounds, settings.serials, strict=False
            )
        }
        self.notice = ""
        self.fault: str | None = None
        """First error of a user-defined estimator."""
        self._frames: queue.Queue[tuple[str, Frame | DeviceError]] = queue.Queue(maxsize=len(sources))
        self._stopping = threading.Event()
        self._threads = [threading.Thread(target=self._wait, args=(s,), daemon=True) for s in sources]
        self._open = len(sources)
        self._fusion, self._zeros = FusedAngles(), list[SlipSample | None]()
        self._object: Reading | None = None
        self._marks: deque[tuple[int, str]] = deque(maxlen=KEPT_MARKS)
        self._marked = 0
        self._saving: threading.Thread | None = None
        self._saved = queue.SimpleQueue[str]()
        self._late_s = 0.0

    def __enter__(self) -> "Desk":
        if any(source.waits for source in self._sources):  # every frame of a clip is estimated
            self._settings.choice.try_making()
        else:
            prepared = self._settings.choice.begin_trying()
            for sensor in self.sensors.values():
                sensor.prepared = prepared
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
        if any(sensor.background.collecting for sensor in self.sensors.values()):
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
        if self._saving is not None:
            self._saving.join()
            self._show_saved()

    @property
    def ended(self) -> bool:
        return self._open == 0

    @property
    def recording(self) -> bool:
        return any(sensor.clip is not None for sensor in self.sensors.values())

    def step(self, timeout_s: float = 0.1) -> list[Reading]:
        """Process the next frame of any sensor; return its reading and, with two sensors, that of the object.

        The list is empty if no frame arrived in time or a source ended, see `ended`. If a sensor has sent no
        frame for `FRAME_TIMEOUT_S`, it has one reading in the state `NO_FRAMES`; so has the object, if none
        of its sensors sends any. Raises `DeviceError` if a sensor fails.
        """
        self._show_saved()
        try:
            name, frame = self._frames.get(timeout=timeout_s)
        except queue.Empty:
            return []
        sensor = self.sensors[name]
        if isinstance(frame, DeviceError):
            before, sensor.reading, sensor.slip = sensor.reading, None, False
            self._say(f"{frame}; {sensor.summary}")
            if not isinstance(frame, DeviceTimeoutError):
                self._open -= 1
                return []
            if before is None:
                return []
            stopped = [before]
            if self._object is not None and not any(each.reading for each in self.sensors.values()):
                stopped.append(self._object)
            silent = [replace(each, state=NO_FRAMES, sample=None, fps=None) for each in stopped]
            for each in silent:
                self._show(each)
            return [replace(each, frame=None) for each in silent]
        if self._sender.pictures:  # only a page can ask for them
            sensor.newest.add(frame)
        if sensor.clip is not None:
            self._record(sensor.clip, frame)
        reading = sensor.take(frame, self._clock)
        self._late_s = reading.latency_s
        if sensor.news:
            self._say(f"{name}: {sensor.news}")
        if self.fault is None and reading.sample is not None and reading.sample.fault is not None:
            self.fault = reading.sample.fault
            self._say(f"the estimator failed; the state is then 'lost': {self.fault}")
        self._show(reading)
        fused = self._object = self._fused(reading)
        if fused is None:
            return [reading]
        self._show(fused)
        return [reading, fused]

    def act(self, text: str) -> None:
        """Carry out an action of the user, see `rig.live.feed`; `notice` then has the result or error."""
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
        if what == SAVE:
            return self._save()
        if what == MARK and name.replace(".", "", 1).isdecimal():
            return self._mark(float(name))
        raise InputError(f"'{text}' is not known: reload the page")

    def _begin_clips(self) -> str:
        started = [self._clip(sensor, RECORD) for sensor in self.sensors.values()]
        try:
            for sensor, start in zip(self.sensors.values(), started, strict=True):
                sensor.clip = start()
        except RecordingError:  # all sensors or none
            self._end_clips()
            raise
        return f"recording to {', '.join(str(s.clip.folder) for s in self.sensors.values() if s.clip)}"

    def _clip(self, sensor: DeskSensor, what: str) -> Callable[[], ClipWriter]:
        """Return a function that creates a clip of a sensor. Raises `InputError` without a background."""
        background = sensor.background
        if background.image is None or background.collecting:
            raise InputError(f"{what}: wait until the background is taken")
        about = {
            "sensor": sensor.name,
            "simulated": self._settings.simulated,
            "background": background.origin,
        }
        image = background.image
        return lambda: ClipWriter(clip_folder(self._settings.clips, sensor.name), image, about)

    def _save(self) -> str:
        """Write the newest frames of each sensor into a clip, in a thread that delays no estimate."""
        if self._saving is not None and self._saving.is_alive():
            raise InputError("save: wait until the clip before is saved")
        sensors = self.sensors.values()
        # frames of a sensor that is unplugged may be older than those of the other one
        newest_ns = max((s.newest.frames[-1].time_ns for s in sensors if s.newest.frames), default=0)
        clips = [(self._clip(s, SAVE), s.newest.since(newest_ns - to_ns(SAVED_S))) for s in sensors]
        self._saving = threading.Thread(target=self._write, args=(clips, list(self._marks)))
        self._saving.start()
        return f"saving the last {SAVED_S:.0f} s"

    def _write(
        self, clips: list[tuple[Callable[[], ClipWriter], list[Frame]]], marks: list[tuple[int, str]]
    ) -> None:
        """Write clips and put their names, or an error, into the queue; runs in a separate thread."""
        done = list[str]()
        try:
            with ordinary():
                for start, frames in clips:
                    clip = start()
                    with closing(clip):
                        for frame in frames:
                            clip.add(frame)
                            for _ in range(SAVE_PAUSES):
                                self._stopping.wait(SAVE_PAUSE_S)
                                if self._late_s < LATE_S:
                                    break
                        for mark in marks:
                            clip.mark(*mark)
                    span_s = (frames[-1].time_ns - frames[0].time_ns) / NS_PER_S if frames else 0.0
                    done.append(f"saved {clip.folder}: {counted(clip.count, 'frame')}, {span_s:.1f} s")
        except RecordingError as error:
            done.append(str(error))
        self._saved.put("; ".join(done))

    def _show_saved(self) -> None:
        with suppress(queue.Empty):
            self._say(self._saved.get_nowait())

    def _mark(self, time_s: float) -> str:
        """Add a mark at a capture time in s to the list of events and to the clips."""
        self._marked += 1
        text = f"mark {self._marked}"
        self._marks.append((to_ns(time_s), text))
        self._sender.send("mark", {"t_s": time_s, "text": text})
        for sensor in self.sensors.values():
            if sensor.clip is not None:
                try:
                    sensor.clip.mark(to_ns(time_s), text)
                except RecordingError as error:
                    return f"{error}; {self._end_clips()}"
        return text

    def _record(self, clip: ClipWriter, frame: Frame) -> None:
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
        newest = tracks[now.name]
        fused = self._fusion.update(newest.newest(), others, newest.previous())
        waits = fused.angle_deg is None and fused.state is State.TRACKING
        return Reading(
            OBJECT,
            now.time_ns,
            fused.disagreement or (NO_REFERENCE if waits else fused.state.value),
            replace(fused, slip=slip),
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
        jpeg, outline = picture(frame.image, frame.jpeg, reading.outline)
        self._sender.send("sensor", {**values, "outline": outline}, jpeg)

    def _say(self, notice: str) -> None:
        self.notice = notice
        self._sender.send("notice", {"text": notice})

    def _wait(self, source: FrameSource) -> None:
        """Pass on a source's frames until it ends or the desk is closed; runs in a separate thread."""
        timeout_s = max(FRAME_TIMEOUT_S, 2.0 / source.rate_hz)
        while not self._stopping.is_set():
            try:
                frame = source.next_frame(timeout_s)
                if not source.waits and self._clock.now_ns() - frame.time_ns > to_ns(LATEST_S):
                    frame = source.newest_frame(timeout_s)
            except StaleFrameError:
                continue
            except DeviceError as error:
                self._frames.put((source.serial, error))
                if not isinstance(error, DeviceTimeoutError):  # after that the source is opened again
                    return
            else:
                self._frames.put((source.serial, frame))


def picture(
    image: Image, jpeg: bytes | None, outline: NDArray[np.float32]
) -> tuple[bytes, list[list[float]]]:
    """Return the JPEG of a frame for the page, and the outline of its contact in px of that JPEG.

    jpeg: of the frame as received, if there is one. outline: see `Reading`.
    """
    scale = 1.0
    if not jpeg or max(image.shape[:2]) > PICTURE_LONG_SIDE_PX:
        jpeg, scale = small_jpeg(image)
    # OpenCV's coordinates are 0 at the centre of the first pixel, a browser's at its corner
    return jpeg, ((outline + 0.5) * scale).round(1).tolist()
