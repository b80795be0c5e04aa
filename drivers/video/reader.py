"""Read a frame source in a thread: keeps the newest frame and a short backlog, and reopens the source.

An unread source delivers its oldest image first, and stops for good at the first failure (measured with
OpenCV: after a pause of 3 s a reader gets the image of 3 s ago). So one thread reads continuously, keeps the
frames of the last two seconds, and reopens the source after a failure.
"""

import threading
from abc import abstractmethod
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from drivers.clock import NS_PER_S, Clock, host_s, require_full_speed, to_ns
from drivers.errors import (
    DamagedFrameError,
    DeviceError,
    DeviceTimeoutError,
    InputError,
    NotConnectedError,
    RigError,
    StaleFrameError,
    without_passwords,
)
from drivers.interfaces import FrameSource
from drivers.tally import PictureNews
from drivers.types import Frame, Image
from drivers.video.files import FolderStream, VideoStream, check_video, image_files
from drivers.video.mjpeg import MjpegStream, split_url
from drivers.video.stream import CaptureTimes, FrameStream, RawFrame, SequenceCounter
from drivers.video.v4l2 import Discover, OpenCapture, V4l2Stream, VideoNode, find_video_node, on_same_bus

_HINT = "check that it still streams, its cable and its port"


class FrameBuffer:
    """The newest frame, the unread frames, and the reason if no more frames arrive.

    backlog: largest number of unread frames. waits: whether a frame waits for room, instead of replacing the
    oldest unread frame.
    """

    def __init__(self, serial: str, clock: Clock, backlog: int, waits: bool = False) -> None:
        self._serial, self._clock, self._waits = serial, clock, waits
        self._changed = threading.Condition()
        self._backlog: deque[Frame] = deque(maxlen=backlog)
        self._newest: Frame | None = None
        self._trouble = ""
        self._remark = _HINT
        self._over = self._closed = False

    def put(self, frame: Frame) -> bool:
        """Add a frame. Return whether the oldest unread frame was dropped for it."""
        with self._changed:
            while self._waits and self._full and not self._closed:
                self._changed.wait()
            full = self._full
            self._backlog.append(frame)
            self._newest, self._trouble, self._remark = frame, "", _HINT
            self._changed.notify_all()
            return full

    def fail(self, trouble: str, over: bool) -> None:
        """Note why no frames arrive. over: no more frames will arrive."""
        with self._changed:
            self._trouble, self._over = trouble, over
            self._changed.notify_all()

    def withhold(self, remark: str) -> None:
        with self._changed:
            self._remark = remark

    def close(self) -> None:
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def next(self, timeout_s: float) -> Frame:
        """Return the oldest unread frame. Raises `DeviceTimeoutError`, `DeviceError` after the last frame."""
        deadline = self._clock.now_ns() + to_ns(timeout_s)
        with self._changed:
            while not self._backlog:
                if self._closed:
                    raise NotConnectedError(f"{self._serial}: disconnected; connect the bench first")
                if self._over:
                    raise DeviceError(self._with_serial(self._trouble))
                self._wait(deadline, f"no frame within {timeout_s:.3g} s")
            self._changed.notify_all()
            return self._backlog.popleft()

    def newest(self, max_age_s: float) -> Frame:
        """Return the newest frame and discard the unread ones. Raises `StaleFrameError`."""
        with self._changed:
            frame = self._newest
            if frame is None:
                raise StaleFrameError(f"{self._serial}: no frame received yet; {self._why()}")
            age_s = (self._clock.now_ns() - frame.time_ns) / NS_PER_S
            if age_s > max_age_s:
                raise StaleFrameError(
                    f"{self._serial}: newest frame is {age_s:.3f} s old, over the limit of "
                    f"{max_age_s:.3f} s; {self._why()}"
                )
            self._backlog.clear()
            self._changed.notify_all()
            return frame

    def await_first(self, timeout_s: float) -> None:
        """Wait for the first frame. Raises `DeviceError` if the reader fails before it."""
        deadline = self._clock.now_ns() + to_ns(timeout_s)
        with self._changed:
            while self._newest is None:
                if self._trouble:
                    raise DeviceError(self._with_serial(self._trouble))
                self._wait(deadline, f"no frame within {timeout_s:.3g} s of opening")

    @property
    def _full(self) -> bool:
        return len(self._backlog) == self._backlog.maxlen

    def _wait(self, deadline_ns: int, missed: str) -> None:
        remaining_ns = deadline_ns - self._clock.now_ns()
        if remaining_ns <= 0:
            raise DeviceTimeoutError(f"{self._serial}: {missed}; {self._why()}")
        self._changed.wait(host_s(self._clock, remaining_ns / NS_PER_S))

    def _with_serial(self, trouble: str) -> str:
        return trouble if trouble.startswith(f"{self._serial}:") else f"{self._serial}: {trouble}"

    def _why(self) -> str:
        return f"{self._trouble}; opening it again" if self._trouble else self._remark


BACKLOG_S = 2.0
"""Unread frames are kept for this long, so that a loaded host can catch up without losing frames."""
OPEN_TIMEOUT_S = 5.0
"""Time limit for the first frame after opening a source."""
STOP_TIMEOUT_S = 0.8
"""Time limit for the end of the reading thread."""
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.1, 2.0
"""Pause before reopening: the first one, doubled after each further failure up to the longest."""
KINDS = ("frames", "unread", "frozen", "green", "shifted", "damaged", "warm_up", "reopened")


Decode = Callable[[RawFrame], tuple[Image, bytes | None]]
Open = Callable[[], FrameStream]


@dataclass(slots=True, eq=False)
class _Run:
    """One connection, from `connect` to `disconnect`, and its thread."""

    buffer: FrameBuffer
    stopping: threading.Event = field(default_factory=threading.Event)
    stream: FrameStream | None = None
    streams: int = 0
    thread: threading.Thread | None = None


class FrameReader(FrameSource):
    """A `FrameSource` for any stream. `open_stream` opens it, `decode` decodes its raw frames.

    Both run in the reader's thread. If they raise `DeviceError`, the source is reopened after 0.1 s; the
    pause doubles with each failure, up to 2 s. The clock must run by itself, because users wait in real time.
    Set `waits` before `connect` to let the frames of a file wait until they are read: if the reader is too
    slow, the file is played more slowly. The times of the frames stay those of its frame rate.
    """

    def __init__(self, serial: str, rate_hz: float, open_stream: Open, decode: Decode, clock: Clock) -> None:
        self.serial, self.rate_hz, self._open_stream = serial, rate_hz, open_stream
        self._decode, self._clock = decode, clock
        self._run: _Run | None = None
        # Written by the reader's thread alone.
        self._counts: Counter[str] = Counter()
        self._count = SequenceCounter(rate_hz)
        self._times = CaptureTimes("arrival")

    @property
    def connected(self) -> bool:
        """Whether it is between `connect` and `disconnect`; frames may nevertheless be missing."""
        return self._run is not None

    def connect(self) -> None:
        """Open the source, discard its warm-up images, and return after the first frame has arrived.

        Raises `DeviceError` if the source cannot be opened, or delivers no frame within 5 s.
        """
        self.disconnect()
        backlog = max(round(BACKLOG_S * self.rate_hz), 1)
        run = _Run(FrameBuffer(self.serial, self._clock, backlog, self.waits))
        run.thread = threading.Thread(target=self._work, args=(run,), name=self.serial, daemon=True)
        self._run = run
        run.thread.start()
        try:
            run.buffer.await_first(OPEN_TIMEOUT_S)
        except DeviceError:
            self.disconnect()
            raise

    def disconnect(self) -> None:
        """Stop reading and close the source. Safe to call twice."""
        run, self._run = self._run, None
        if run is None:
            return
        run.stopping.set()
        run.buffer.close()
        if run.stream is not None:
            run.stream.interrupt()
        # A device driver stuck in the kernel cannot be woken; its thread ends when the kernel returns.
        if run.thread is not None:
            run.thread.join(host_s(self._clock, STOP_TIMEOUT_S))

    def next_frame(self, timeout_s: float) -> Frame:
        return self._require_run().buffer.next(timeout_s)

    def newest_frame(self, max_age_s: float) -> Frame:
        return self._require_run().buffer.newest(max_age_s)

    def counters(self) -> dict[str, int]:
        """Return event counts since the driver was created.

        frames: delivered; unread: delivered, but lost because they were not read in time; dropped: never
        received; frozen: copies of an earlier picture (delivered nevertheless); green, shifted, damaged: not
        delivered; warm_up: discarded after opening; reopened: after failures.
        """
        return {"dropped": self._count.dropped} | {kind: self._counts[kind] for kind in KINDS}

    @property
    def time_kind(self) -> str:
        """Origin of `Frame.time_ns`.

        "kernel", "peer" or "schedule" (of a file): the time stamp of the source. "arrival": the source gives
        no time of this computer's clock.
        """
        return self._times.kind

    def _require_run(self) -> _Run:
        run = self._run
        if run is None:
            raise NotConnectedError(f"{self.serial}: read before connect; connect the bench first")
        return run

    # From here on: the reader's thread.

    def _work(self, run: _Run) -> None:
        pause_s = FIRST_PAUSE_S
        while not run.stopping.is_set():
            frames = self._counts["frames"]
            try:
                self._read_one_stream(run)
            except RigError as error:
                over = run.stream is not None and run.stream.ends
                run.buffer.fail(str(error), over)
                if over:
                    return
            except Exception as error:  # a bug: callers waiting for a frame get an error first
                run.buffer.fail(f"its reader failed ({type(error).__name__}: {error}); report this", True)
                raise
            pause_s = FIRST_PAUSE_S if self._counts["frames"] > frames else min(2 * pause_s, LONGEST_PAUSE_S)
            run.stopping.wait(host_s(self._clock, pause_s))

    def _read_one_stream(self, run: _Run) -> None:
        run.stream = None
        run.stream = stream = self._open_stream()
        times = CaptureTimes(stream.stamp)
        try:
            for _ in range(stream.warm_up):
                if run.stopping.is_set():
                    return
                stream.read()
                self._counts["warm_up"] += 1
            failed_before = run.streams > 0
            run.streams += 1
            self._counts["reopened"] += failed_before
            self._count.note_opening(after_failure=failed_before)
            news = PictureNews()
            while not run.stopping.is_set():
                self._take(run, stream, times, news)
        finally:
            stream.close()

    def _take(self, run: _Run, stream: FrameStream, times: CaptureTimes, news: PictureNews) -> None:
        raw = stream.read()
        time_ns = times.time_of(raw)
        sequence = self._count.sequence_of(raw.number, time_ns, times.kind != "arrival")
        try:
            image, jpeg = self._decode(raw)
        except DamagedFrameError as error:
            self._counts[error.kind] += 1
            run.buffer.withhold(str(error))
            return
        frame = Frame(image, time_ns, sequence, self.serial, jpeg)
        news.add(frame.image, time_ns)
        self._counts["frozen"] += news.repeated
        self._times = times
        self._counts["frames"] += 1
        self._counts["unread"] += run.buffer.put(frame)


@dataclass(frozen=True, slots=True)
class SourceSpec:
    """Which source to open. size_px: raw (width, height); None accepts any size.

    address: "/dev/videoN", "http://HOST:PORT/PATH", a folder or a video file; None finds the device with
    this serial number through `discover`.
    """

    serial: str
    address: str | None
    size_px: tuple[int, int] | None
    rate_hz: float

    def __post_init__(self) -> None:
        """Raise `InputError` for an address, size or rate that can never be opened."""
        if not self.rate_hz > 0:
            raise InputError(f"{self.serial}: rate_hz is {self.rate_hz}; give frames per second")
        if self.size_px is not None and min(self.size_px) < 1:
            raise InputError(f"{self.serial}: size_px is {self.size_px}; give width and height in px")
        address = self.address
        if address is not None and "://" in address:
            split_url(address)
        elif address is not None and not self.is_device:
            path = Path(address)
            if not path.exists():
                raise InputError(
                    f"{self.serial}: '{without_passwords(address)}' does not exist; give /dev/videoN, "
                    "http://HOST:PORT/PATH, a folder of images or a video file"
                )
            (image_files if path.is_dir() else check_video)(path)

    @property
    def is_device(self) -> bool:
        """Whether it is a video device of this computer."""
        return self.address is None or self.address.startswith("/dev/")

    @property
    def host(self) -> str | None:
        """Network host of a stream; None for any other source."""
        return split_url(self.address).hostname if self.address and "://" in self.address else None


def open_source(spec: SourceSpec, clock: Clock, discover: Discover, open_device: OpenCapture) -> FrameStream:
    """Open a source, and set its size and rate. Raises `DeviceError`."""
    address = spec.address
    if address is None or spec.is_device:
        nodes = discover()
        if address is None:
            node = find_video_node(spec.serial, nodes)
        else:  # udev need not list it
            known = (node for node in nodes if node.device == address)
            node = next(known, VideoNode(address, spec.serial))
            elsewhere = [other.device for other in nodes if other.serial == spec.serial != node.serial]
            if elsewhere:
                raise DeviceError(
                    f"{spec.serial}: it is at {elsewhere[0]}, and {address} has the serial {node.serial}: "
                    "the sensors were exchanged, or their numbers have changed; remove the address from the "
                    "bench file, so that the sensor is found by its serial"
                )
        return V4l2Stream(node, spec.size_px, spec.rate_hz, clock, open_device, on_same_bus(node, nodes))
    if "://" in address:
        stream = MjpegStream(address, spec.rate_hz, clock)
        try:
            # size before rate, because a new size resets the rate
            size = [] if spec.size_px is None else [{"size_px": list(spec.size_px)}]
            stream.configure([*size, {"rate_hz": spec.rate_hz}])
        except DeviceError:
            stream.close()
            raise
        return stream
    path = Path(address)
    return (FolderStream if path.is_dir() else VideoStream)(path, spec.rate_hz, clock)


class AddressedSource(FrameReader):
    """A frame source at an address. Subclasses set it up after opening, and decode its frames."""

    def __init__(self, spec: SourceSpec, clock: Clock, discover: Discover, open_device: OpenCapture) -> None:
        super().__init__(spec.serial, spec.rate_hz, self._open, self._decode, clock)
        require_full_speed(clock, spec.serial, spec.host)
        self._spec, self._clock, self._discover = spec, clock, discover
        self._open_device = open_device
        self._opened: FrameStream | None = None
        """The stream that was opened last."""

    def identity(self) -> dict[str, str]:
        """Return what the device reports about itself (if it has been opened), and where it was found."""
        node = self._opened.node if isinstance(self._opened, V4l2Stream) else VideoNode("", "")
        address = "" if self._opened is None else node.device or self._spec.address or ""
        return {
            "serial": self.serial,
            "model": node.model,
            "firmware": node.revision,
            "usb": f"{node.usb_bus} port {node.usb_port}" if node.usb_bus else "",
            "address": without_passwords(address),
            "capture time": self.time_kind,
        }

    def _prepare(self, stream: FrameStream) -> None:
        """Set up a source after it was opened, beyond its size and rate. Raises `DeviceError`."""

    @abstractmethod
    def _decode(self, raw: RawFrame) -> tuple[Image, bytes | None]:
        """Decode a frame, as `decode_frame`. Raises `DeviceError`."""

    def _open(self) -> FrameStream:
        stream = open_source(self._spec, self._clock, self._discover, self._open_device)
        try:
            if isinstance(stream, V4l2Stream) and isinstance(self._opened, V4l2Stream):
                self._require_same_device(self._opened.node, stream.node)
            self._prepare(stream)
        except DeviceError:
            stream.close()
            raise
        self._opened = stream
        return stream

    def _require_same_device(self, before: VideoNode, now: VideoNode) -> None:
        """Raise `DeviceError` if another device is at the address than when it was last opened."""
        if before.serial and now.serial and now.serial != before.serial:
            raise DeviceError(
                f"{self.serial}: the device at {now.device} has the serial {now.serial}, it had "
                f"{before.serial}: the sensors were exchanged; check their cables, then start again"
            )
