"""Reads a source of frames in a thread of its own: newest frame, short backlog, re-opening.

A source on its own hands out its oldest image first and stops for good at the first failure
(measured with OpenCV: a reader that pauses for 3 s then gets the image of 3 s ago). So one thread
reads all the time, keeps the frames of the last two seconds, and opens the source again after a failure.
"""

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

from drivers.clock import Clock
from drivers.errors import DamagedFrameError, DeviceError, NotConnectedError, RigError
from drivers.interfaces import FrameSource
from drivers.tally import FrameTally
from drivers.types import Frame
from drivers.video.buffer import FrameBuffer
from drivers.video.decode import DecodedFrame
from drivers.video.stream import CaptureTimes, FrameStream, RawFrame, SequenceCounter

BACKLOG_S = 2.0
"""Unread frames are kept so long: a busy computer catches up with them and loses none."""
OPEN_TIMEOUT_S = 5.0
STOP_TIMEOUT_S = 0.8
FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.1, 2.0
KINDS = ("frames", "unread", "frozen", "green", "shifted", "damaged", "warm_up", "reopened")


Decode = Callable[[RawFrame], DecodedFrame]
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
    """A `FrameSource` over any stream. `open_stream` opens it, `decode` decodes its raw frames.

    Both run in the reader's thread and raise `DeviceError` for a failure after which the source
    is opened again (after 0.1 s, then twice as long each time, at most 2 s). The clock has to be
    one that passes by itself: users wait in real time.
    """

    def __init__(self, serial: str, rate_hz: float, open_stream: Open, decode: Decode, clock: Clock) -> None:
        self._serial = serial
        self._rate_hz = rate_hz
        self._open_stream = open_stream
        self._decode = decode
        self._clock = clock
        self._run: _Run | None = None
        # Written by the reader's thread alone.
        self._counts: Counter[str] = Counter()
        self._count = SequenceCounter(rate_hz)
        self._times = CaptureTimes("arrival")

    @property
    def serial(self) -> str:
        """Serial number, stable over reconnects."""
        return self._serial

    @property
    def rate_hz(self) -> float:
        """Requested frame rate."""
        return self._rate_hz

    @property
    def connected(self) -> bool:
        """Whether it is between `connect` and `disconnect`; frames may be missing all the same."""
        return self._run is not None

    def connect(self) -> None:
        """Open the source, discard its warm-up images, and return with the first frame there.

        Raises `DeviceError` when it cannot be opened, or gives none within 5 s.
        """
        self.disconnect()
        backlog = max(round(BACKLOG_S * self._rate_hz), 1)
        run = _Run(FrameBuffer(self._serial, self._clock, backlog))
        run.thread = threading.Thread(target=self._work, args=(run,), name=self._serial, daemon=True)
        self._run = run
        run.thread.start()
        try:
            run.buffer.await_first(OPEN_TIMEOUT_S)
        except DeviceError:
            self.disconnect()
            raise

    def disconnect(self) -> None:
        """Stop reading and let the source go. Safe to call twice."""
        run, self._run = self._run, None
        if run is None:
            return
        run.stopping.set()
        run.buffer.close()
        if run.stream is not None:
            run.stream.interrupt()
        # A driver stuck in the kernel cannot be woken; its thread ends when the kernel lets it.
        if run.thread is not None:
            run.thread.join(STOP_TIMEOUT_S)

    def next_frame(self, timeout_s: float) -> Frame:
        """Oldest frame not read yet, see `drivers.interfaces.FrameSource`."""
        return self._connected().buffer.next(timeout_s)

    def newest_frame(self, max_age_s: float) -> Frame:
        """Newest frame, see `drivers.interfaces.FrameSource`."""
        return self._connected().buffer.newest(max_age_s)

    def counters(self) -> dict[str, int]:
        """What happened since the driver was made.

        frames: delivered; unread: of these, lost because nobody read them in time; dropped: never
        came; frozen: identical to the one before (delivered all the same); green, shifted,
        damaged: withheld; warm_up: discarded after opening; reopened: after failures.
        """
        return {"dropped": self._count.dropped} | {kind: self._counts[kind] for kind in KINDS}

    @property
    def time_kind(self) -> str:
        """What `Frame.time_ns` is.

        The stamp of the "kernel", the "peer" or the file's "schedule", or the "arrival" here,
        where the source gives no time of our clock.
        """
        return self._times.kind

    def _connected(self) -> _Run:
        run = self._run
        if run is None:
            raise NotConnectedError(f"{self._serial}: read before connect; connect the bench first")
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
            except Exception as error:  # a bug of ours: whoever waits for a frame is told of it first
                run.buffer.fail(f"its reader failed ({type(error).__name__}: {error}); report this", True)
                raise
            pause_s = FIRST_PAUSE_S if self._counts["frames"] > frames else min(2 * pause_s, LONGEST_PAUSE_S)
            run.stopping.wait(pause_s)

    def _read_one_stream(self, run: _Run) -> None:
        """Read until the stream fails or the run is stopped."""
        run.stream = None
        run.stream = stream = self._open_stream()
        times = CaptureTimes(stream.stamp)
        try:
            self._warm_up(run, stream)
            self._opened(run)
            tally = FrameTally()
            while not run.stopping.is_set():
                self._take(run, stream, times, tally)
        finally:
            stream.close()

    def _warm_up(self, run: _Run, stream: FrameStream) -> None:
        for _ in range(stream.warm_up):
            if run.stopping.is_set():
                return
            stream.read()
            self._counts["warm_up"] += 1

    def _opened(self, run: _Run) -> None:
        failed_before = run.streams > 0
        run.streams += 1
        self._counts["reopened"] += failed_before
        self._count.opened(after_failure=failed_before)

    def _take(self, run: _Run, stream: FrameStream, times: CaptureTimes, tally: FrameTally) -> None:
        """Read, judge and deliver one image."""
        raw = stream.read()
        time_ns = times.time_of(raw)
        sequence = self._count.sequence_of(raw.number, time_ns, times.kind != "arrival")
        try:
            decoded = self._decode(raw)
        except DamagedFrameError as error:
            self._withhold(run, "damaged", str(error))
            return
        if decoded.flaw is not None:
            self._withhold(run, decoded.flaw, f"its images are {decoded.flaw}; check its cable")
            return
        frame = Frame(decoded.image, time_ns, sequence, self._serial, decoded.jpeg)
        tally.add(frame)
        self._counts["frozen"] += tally.repeated
        self._times = times
        self._counts["frames"] += 1
        self._counts["unread"] += run.buffer.put(frame)

    def _withhold(self, run: _Run, kind: str, remark: str) -> None:
        self._counts[kind] += 1
        run.buffer.withhold(remark)
