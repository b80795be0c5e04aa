"""One or two sensors on a desk: a live angle without a bench.

A thread per sensor waits for its frames (`Streams`); one thread estimates, records and sends to viewers.
Nothing here moves hardware.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S, Clock, SystemClock, to_ns
from drivers.errors import DeviceError, DeviceTimeoutError, InputError, RecordingError, RigError
from drivers.interfaces import FrameSource
from drivers.types import Frame, Image
from rig.frames.estimates import require_frames_suffice
from rig.lift.object_angle import FusedAngles
from rig.live.clip_writer import Clips
from rig.live.desk_sensor import DeskSensor, Reading, Streams
from rig.live.feed import ESTIMATOR, MARK, OBJECT, RECORD, REFERENCE, SAVE, TAKE_BACKGROUND, Sender
from rig.live.observer import PICTURE_LONG_SIDE_PX, small_jpeg
from rig.tactile.estimators import ESTIMATORS, EstimatorChoice, choose_estimator
from rig.tactile.sample import SlipSample, State

NO_REFERENCE = "no reference yet"
"""State of the object while its sensors track a contact that has no reference."""
TOUCH_NOTHING = "taking the background: nothing may touch the gel"


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
    """Sensors on a desk. A context manager: it connects the sources and disconnects them.

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
        of_sensors = zip(sources, settings.signs, settings.backgrounds, settings.serials, strict=False)
        self.sensors = {
            of.serial: DeskSensor(of.serial, settings.choice, sign, background, settings.aspect, serial)
            for of, sign, background, serial in of_sensors
        }
        self.notice = ""
        self.fault: str | None = None
        """First error of a user-defined estimator."""
        self._streams, self._object = Streams(sources, self._clock), FusedObject(self.sensors, self._clock)
        backgrounds = {name: sensor.background for name, sensor in self.sensors.items()}
        # only a page can ask for the newest frames
        self.clips = Clips(settings.clips, backgrounds, settings.simulated, sender.pictures)
        self._marked = 0

    def __enter__(self) -> "Desk":
        if any(source.waits for source in self._sources):  # every frame of a clip is estimated
            self._settings.choice.try_making()
        else:
            is_prepared = self._settings.choice.begin_trying()
            for sensor in self.sensors.values():
                sensor.wait_until(is_prepared)
        with ExitStack() as connected:
            for source in self._sources:
                source.connect()
                connected.callback(source.disconnect)
            connected.pop_all()
        self._streams.start()
        if any(sensor.background.image is None for sensor in self.sensors.values()):
            self._say(TOUCH_NOTHING)
        return self

    def __exit__(self, *_: object) -> None:
        self._streams.close()
        self.clips.close()
        self._say(self.clips.take_saved())

    @property
    def has_ended(self) -> bool:
        """Whether each source has ended."""
        return self._streams.has_ended

    def step(self, timeout_s: float = 0.1) -> list[Reading]:
        """Process the next frame of any sensor; return its reading and, with two sensors, that of the object.

        The list is empty if no frame arrived in time or a source ended, see `has_ended`. If a sensor sends no
        frames, it has one reading in the state `NO_FRAMES`; so has the object, if none of its sensors sends
        any. Raises `DeviceError` if a sensor fails.
        """
        self._say(self.clips.take_saved())
        arrived = self._streams.next(timeout_s)
        if arrived is None:
            return []
        sensor, frame = self.sensors[arrived[0]], arrived[1]
        return self._lose(sensor, frame) if isinstance(frame, DeviceError) else self._take(sensor, frame)

    def act(self, text: str) -> None:
        """Carry out an action of the user, see `ACTIONS`; `notice` then has the result or error."""
        name, _, argument = text.partition(" ")
        try:
            done = ACTIONS[name](self, argument) if name in ACTIONS else None
            self._say(done or f"'{text}' is not known: reload the page")
        except RigError as error:
            self._say(str(error))

    def set_reference(self) -> str:
        """Set the reference of all sensors now. Raises `InputError` if one has no contact."""
        for sensor in self.sensors.values():
            sensor.set_reference()
        return "reference taken: the angle counts from here"

    def take_background(self) -> str:
        """Take the background of all sensors from their next frames."""
        for sensor in self.sensors.values():
            sensor.take_background()
        return TOUCH_NOTHING

    def use_estimator(self, name: str) -> str | None:
        """Change the estimator of all sensors, or of none; return None for a name that cannot be chosen.

        Raises `EstimatorError` or `InputError` if it cannot be made.
        """
        if name not in self._settings.estimators:
            return None
        choice = replace(choose_estimator(name), gel=self._settings.choice.gel)
        require_frames_suffice(choice)
        streams = [sensor.make_stream(choice) for sensor in self.sensors.values()]
        for sensor, stream in zip(self.sensors.values(), streams, strict=True):
            sensor.choose(choice, stream)
        return f"estimator {name}"

    def record(self) -> str:
        """Begin clips, or end those that are recorded. Raises `InputError`, `RecordingError`."""
        return self.clips.end() if self.clips.is_recording else self.clips.begin()

    def mark(self, time_s: str) -> str | None:
        """Add a mark to the list of events and to the clips; return None for an invalid time.

        time_s: capture time in s. Raises `RecordingError` if a clip cannot be written.
        """
        if not time_s.replace(".", "", 1).isdecimal():
            return None
        self._marked += 1
        text = f"mark {self._marked}"
        self._sender.send("mark", {"t_s": float(time_s), "text": text})
        self.clips.mark(to_ns(float(time_s)), text)
        return text

    def _take(self, sensor: DeskSensor, frame: Frame) -> list[Reading]:
        reading = sensor.take(frame, self._clock)
        try:
            self.clips.add(sensor.name, frame, reading.latency_s)
        except RecordingError as error:
            self._say(str(error))
        if sensor.news:
            self._say(f"{sensor.name}: {sensor.news}")
        if self.fault is None and reading.sample is not None and reading.sample.fault is not None:
            self.fault = reading.sample.fault
            self._say(f"the estimator failed; the state is then 'lost': {self.fault}")
        fused = self._object.update(reading)
        readings = [reading] if fused is None else [reading, fused]
        for each in readings:
            self._show(each)
        return readings

    def _lose(self, sensor: DeskSensor, error: DeviceError) -> list[Reading]:
        """Report that a sensor sends no frames; return readings for it, and for the object of silent sensors.

        They are returned once. The page shows them with the last frame.
        """
        lost = sensor.lose_frames()
        self._say(f"{error}; {sensor.summary}")
        if lost is None or not isinstance(error, DeviceTimeoutError):
            return []
        both = None if any(each.reading for each in self.sensors.values()) else self._object.lose_frames()
        readings = [lost] if both is None else [lost, both]
        for each in readings:
            self._show(each)
        return [replace(each, frame=None) for each in readings]

    def _show(self, reading: Reading) -> None:
        values = {"recording": self.clips.is_recording, **reading.values()}
        if (frame := reading.frame) is None:
            self._sender.send("sensor", values)
            return
        jpeg, outline = picture(frame.image, frame.jpeg, reading.outline)
        self._sender.send("sensor", {**values, "outline": outline}, jpeg)

    def _say(self, notice: str | None) -> None:
        if notice is not None:
            self.notice = notice
            self._sender.send("notice", {"text": notice})


ACTIONS: Mapping[str, Callable[[Desk, str], str | None]] = {
    REFERENCE: lambda desk, _: desk.set_reference(),
    TAKE_BACKGROUND: lambda desk, _: desk.take_background(),
    ESTIMATOR: Desk.use_estimator,
    RECORD: lambda desk, _: desk.record(),
    SAVE: lambda desk, _: desk.clips.save_last(),
    MARK: Desk.mark,
}
"""The functions of a desk by action of the page. Each returns the notice, None for an invalid argument."""


class FusedObject:
    """The angle of the object that two sensors touch. With one sensor it has no readings."""

    def __init__(self, sensors: Mapping[str, DeskSensor], clock: Clock) -> None:
        self._sensors, self._clock = sensors, clock
        self._fusion, self._zeros = FusedAngles(), list[SlipSample | None]()
        self._reading: Reading | None = None

    def update(self, now: Reading) -> Reading | None:
        """Return the object's angle at a sensor's newest frame; None if this frame was not estimated."""
        self._reading = None if len(self._sensors) < 2 or now.sample is None else self._fuse(now)
        return self._reading

    def lose_frames(self) -> Reading | None:
        """Return the reading for the end of the frames of all sensors, None without any before."""
        return None if self._reading is None else self._reading.without_frames()

    def _fuse(self, now: Reading) -> Reading:
        streams = {name: sensor.stream for name, sensor in self._sensors.items() if sensor.stream is not None}
        tracks = {name: stream.track for name, stream in streams.items() if stream.track.samples}
        zeros = [track.zero_sample for track in tracks.values()]
        zeros_s = [sensor.zero_s for sensor in self._sensors.values()]
        if zeros != self._zeros:
            self._zeros = zeros
            self._fusion.restart()
        newest, others = (
            tracks[now.name],
            [track.newest() for name, track in tracks.items() if name != now.name],
        )
        fused = self._fusion.update(newest.newest(), others, newest.previous())
        time_ns = max(track.newest().time_ns for track in tracks.values())  # frames may arrive out of order
        waits = fused.angle_deg is None and fused.state is State.TRACKING
        return Reading(
            OBJECT,
            time_ns,
            fused.disagreement or (NO_REFERENCE if waits else fused.state.value),
            replace(fused, slip=any(sensor.slip for sensor in self._sensors.values())),
            fps=now.fps,
            latency_s=(self._clock.now_ns() - time_ns) / NS_PER_S,
            dropped=sum(sensor.dropped for sensor in self._sensors.values()),
            zero_s=None if None in zeros_s else max(time_s for time_s in zeros_s if time_s is not None),
            slips_s=tuple(sorted(time_s for stream in streams.values() for time_s in stream.slips_s)),
        )


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
