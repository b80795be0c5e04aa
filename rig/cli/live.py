"""`rig live`: the angle of one or two sensors on a desk, without a bench."""

import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import InputError
from rig.cli.common import STOPS, Exit, mark, say
from rig.cli.declared import argument, option
from rig.cli.watching import foxglove_server

if TYPE_CHECKING:
    from drivers.interfaces import FrameSource
    from rig.live.desk import Desk, DeskSettings
    from rig.live.desk_sensor import Reading
    from rig.live.feed import Listener
    from rig.live.watch import WatchPage

CLIPS = Path("clips")
TERMINAL_EVERY_S = 0.1
SHOW_CURSOR = b"\x1b[?25h"
"""Escape sequence (DECTCEM, VT220) that undoes what a display of rich's does to the cursor."""
PLAIN_EVERY_S = 1.0
"""Away from a terminal: a line per sensor this often."""


@dataclass(frozen=True, slots=True)
class LiveSourceOptions:
    """The sensors."""

    sources: list[str] = argument(
        ...,
        "One or two of: a DIGIT's serial, /dev/videoN or its number, an MJPEG address (http://...), a video, "
        "a folder of images, fake.",
    )
    sensor: str | None = option(
        None,
        "digit, gelsight-mini (its own resolution; the border without gel is cut off) or plain (frames as "
        "they come). Default: digit for a serial or a device, else plain.",
    )
    fps: float | None = option(
        None, "Frame rate in Hz. Default: the sensor's or the video's own; images 60.", min=0.1, max=1000.0
    )
    same_side: bool = option(
        False, "Two sensors see the object from the same side. Default: from both sides, as fingers do."
    )


@dataclass(frozen=True, slots=True)
class LiveAngleOptions:
    """How the angle is estimated."""

    estimator: str | None = option(None, "As in rig estimate. Default: slip.")
    background: Path | None = option(
        None, "Frame without contact. Default: the mean of the first 15 frames: let nothing touch the gel."
    )
    pixel_aspect: float | None = option(
        None, "Width over height of a pixel on the gel. Default: unknown.", min=0.5, max=2.0
    )


@dataclass(frozen=True, slots=True)
class LiveViewOptions:
    """How it is shown."""

    terminal: bool = option(False, "Show it as text, without a page.")
    json: bool = option(False, "Print a JSON object per frame, one per line, without a page.")
    browser: bool = option(True, "Open the page in the browser.", "--browser/--no-browser")
    watch_at: str | None = option(
        None,
        "The page at HOST:PORT; 0.0.0.0:8080 lets other computers look on and press its buttons. Default: a "
        "free port of this computer alone.",
    )
    foxglove: bool = option(False, "Serve it to Foxglove on this computer (extra 'foxglove').")
    foxglove_at: str | None = option(None, "The same at HOST:PORT, by default 127.0.0.1:8765.")
    clips: Path = option(CLIPS, "Folder in which clips are recorded.")
    seconds: float | None = option(None, "End after this time. Default: Ctrl-C ends it.", min=0.0)


def live(source: LiveSourceOptions, how: LiveAngleOptions, view: LiveViewOptions) -> None:
    """Show the angle of a tactile sensor live, without a bench: in the browser, as text or as JSON.

    The page shows each sensor's frame with the contact's outline, the angle with its sigma over the last 30
    seconds, state, rate, slip alarm, frame rate and latency. Two sensors side by side are fused. The first
    frames become the background; the angle counts from the moment the contact has settled. Buttons take
    another reference or background, switch the estimator, and record a clip that rig label-angle, rig
    estimate and rig benchmark clips read. Nothing is moved. Ctrl-C ends it.

    Examples:
      rig live fake

      rig live D20641 --no-browser

      rig live /dev/video2 --sensor gelsight-mini

      rig live http://127.0.0.1:8080/stream.mjpg --json

      rig live lift.avi --terminal --background empty.png

      rig live fake fake --terminal --seconds 10

      rig live D20641 --no-browser --foxglove

    """
    from drivers.realtime import compute_in_one_thread

    with ExitStack() as stack:
        stopped = stack.enter_context(stopped_by_person())
        page = None if view.terminal or view.json else _page(source, how.estimator, view, stack)
        sources, settings = sources_of(source), settings_of(source, how, view.clips)
        say(f"{_name(source)}; Ctrl-C ends it" if page is None else f"live at {page.address}; Ctrl-C ends it")
        if page is not None and view.browser:
            _open(page.address)
        compute_in_one_thread()
        listeners = [*([] if page is None else [page.listener]), *_foxglove(view, sources, stack)]
        desk = stack.enter_context(desk_of(sources, settings, stack, listeners))
        run_desk(desk, _shown(view, stack), view.seconds, stopped, page)
    say("ended")


def _name(source: LiveSourceOptions) -> str:
    """Return the command with its sensors, marked as simulated if one is."""
    from rig.bench.live_source import FAKE

    return f"{mark(FAKE in source.sources)}rig live {' '.join(source.sources)}"


def _page(
    source: LiveSourceOptions, estimator: str | None, view: LiveViewOptions, stack: ExitStack
) -> "WatchPage":
    """Serve the page: its process starts up while this one does."""
    from rig.live.watch import WatchPage, watch_address
    from rig.tactile.estimators import DEFAULT_ESTIMATOR, ESTIMATORS, TOSKOV

    names = dict.fromkeys([estimator or DEFAULT_ESTIMATOR, *ESTIMATORS])
    choices = [name for name in names if name != TOSKOV]
    page = WatchPage(watch_address(view.watch_at), _name(source), estimators=choices)
    stack.callback(page.close)
    return page


def _open(address: str) -> None:
    """Open the page in the browser."""
    import webbrowser

    if not webbrowser.open(address):
        say("no browser opened: open that address in one on this computer")


def _foxglove(view: LiveViewOptions, sources: "Sequence[FrameSource]", stack: ExitStack) -> "list[Listener]":
    """Serve to Foxglove if that was asked for; return the listener."""
    server = foxglove_server(view.foxglove, view.foxglove_at, {each.serial: each.serial for each in sources})
    if server is None:
        return []
    from rig.live.session import foxglove_listener

    return [stack.enter_context(foxglove_listener(server))]


def sources_of(source: LiveSourceOptions) -> "list[FrameSource]":
    """Return the sensors of the options, not connected yet. Raises `InputError`, `DeviceError`."""
    from rig.bench.live_source import SENSORS, live_sources

    if len(source.sources) > 2:
        raise InputError(f"{len(source.sources)} sources: give one, or two that touch the same object")
    if source.sensor not in (None, *SENSORS):
        raise InputError(f"--sensor {source.sensor}: choose one of {', '.join(SENSORS)}")
    return live_sources(source.sources, source.sensor, source.fps)


def settings_of(source: LiveSourceOptions, how: LiveAngleOptions, clips: Path = CLIPS) -> "DeskSettings":
    """Return how the desk of the options runs. Raises `InputError`."""
    from drivers.images import read_image
    from rig.frames.estimation import require_frames_suffice
    from rig.live.desk import DeskSettings
    from rig.tactile.estimators import choose_estimator

    choice = choose_estimator(how.estimator)
    require_frames_suffice(choice)
    background = None if how.background is None else read_image(how.background)
    signs = (1, 1) if source.same_side else (1, -1)
    return DeskSettings(choice, signs, background, how.pixel_aspect, clips)


def desk_of(
    sources: "Sequence[FrameSource]",
    settings: "DeskSettings",
    stack: ExitStack,
    listeners: "Sequence[Listener]" = (),
) -> "Desk":
    """Return the desk of sensors that are not connected yet. listeners: viewers that its messages go to."""
    from rig.live.desk import Desk
    from rig.live.feed import LiveFeed, Sender

    sender = Sender(LiveFeed(tuple(listeners)))
    stack.callback(sender.close)
    return Desk(sources, settings, sender)


@contextmanager
def stopped_by_person() -> Iterator[threading.Event]:
    """Yield an event that is set by Ctrl-C, a polite kill or a lost terminal; a second one ends the program.

    An error that is raised wherever the program is just then would leave the threads' locks in disorder, and
    Python's own end beside threads that are inside a camera's driver has crashed: so neither happens.
    """
    stopped = threading.Event()

    def stop(*_: object) -> None:
        if stopped.is_set():
            if sys.stdout.isatty():
                os.write(1, SHOW_CURSOR)
            os._exit(Exit.STOPPED)
        stopped.set()

    heard = [n for n in (*STOPS, signal.SIGHUP) if signal.getsignal(n) is not signal.SIG_IGN]
    before = {number: signal.signal(number, stop) for number in heard}
    try:
        yield stopped
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def run_desk(
    desk: "Desk",
    show: "Callable[[Reading], None]",
    seconds: float | None,
    stopped: threading.Event,
    page: "WatchPage | None" = None,
) -> None:
    """Step until a person stops it, the time is over, or, without a page, all sources have ended."""
    from drivers.clock import SystemClock, to_ns

    clock, notice = SystemClock(), ""
    end_ns = None if seconds is None else clock.now_ns() + to_ns(seconds)
    while not stopped.is_set() and (end_ns is None or clock.now_ns() < end_ns):
        for reading in desk.step():
            show(reading)
        if page is not None and (asked := page.asked()) is not None:
            desk.act(asked)
        if desk.notice != notice:
            notice = desk.notice
            say(notice)
        if desk.ended and page is None:
            return


def _shown(view: LiveViewOptions, stack: ExitStack) -> "Callable[[Reading], None]":
    """Return what shows a reading at the terminal."""
    if view.json:
        return lambda reading: print(json.dumps(reading.values()), flush=True)
    return stack.enter_context(_Terminal()) if view.terminal else lambda reading: None


class _Terminal:
    """A line per sensor: in place on a terminal, a new one each second elsewhere."""

    def __init__(self) -> None:
        from rich.live import Live

        from rig.live.console import PlainConsole

        self._lines: dict[str, str] = {}
        self._due_ns: dict[str, int] = {}
        console = PlainConsole()
        self._live = Live(console=console, auto_refresh=False) if console.is_terminal else None
        self._shown = ExitStack()

    def __enter__(self) -> "_Terminal":
        from rig.live.screen import shown

        if self._live is not None:
            self._shown.enter_context(shown(self._live))
        return self

    def __exit__(self, *_: object) -> None:
        self._shown.close()

    def __call__(self, reading: "Reading") -> None:
        """Show a reading if one is due."""
        from drivers.clock import to_ns

        if reading.time_ns < self._due_ns.get(reading.name, 0):
            return
        every_s = PLAIN_EVERY_S if self._live is None else TERMINAL_EVERY_S
        self._due_ns[reading.name] = reading.time_ns + to_ns(every_s)
        self._lines[reading.name] = _line(reading)
        if self._live is None:
            print(self._lines[reading.name], flush=True)
        else:
            self._live.update("\n".join(self._lines.values()), refresh=True)


def _line(reading: "Reading") -> str:
    sample = reading.sample
    angle = "angle     -    "
    if sample is not None and sample.angle_deg is not None:
        sigma = "" if sample.sigma_deg is None else f" +- {sample.sigma_deg:.1f}"
        angle = f"angle {sample.angle_deg:+6.1f}{sigma} deg"
    rate = "" if sample is None or sample.rate_deg_s is None else f", {sample.rate_deg_s:+.1f} deg/s"
    slip = "  SLIP" if sample is not None and sample.slip else ""
    fps = "-" if reading.fps is None else f"{reading.fps:.0f}"
    return (
        f"{reading.name}: {angle}{rate}, {reading.state}{slip}; {fps} frames/s, {reading.dropped} dropped, "
        f"{1e3 * reading.latency_s:.0f} ms"
    )
