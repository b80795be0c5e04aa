"""`rig live`: the angle of one or two sensors on a desk, without a bench."""

import json
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.errors import InputError, OperatorStopError
from rig.cli.common import STOPS, mark, say
from rig.cli.declared import argument, option

if TYPE_CHECKING:
    from rig.live.desk import Desk, DeskSettings
    from rig.live.desk_sensor import Reading
    from rig.live.watch import WatchPage

CLIPS = Path("clips")
TERMINAL_EVERY_S = 0.1
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

    """
    from drivers.realtime import compute_in_one_thread

    with ExitStack() as stack:
        stopped = stack.enter_context(stopped_by_person())
        page = None if view.terminal or view.json else _page(source, how.estimator, view, stack)
        compute_in_one_thread()
        if page is None:
            say(f"{_name(source)}; Ctrl-C ends it")
        desk = stack.enter_context(desk_of(source, how, stack, page, view.clips))
        run_desk(desk, _shown(view, stack), view.seconds, stopped, page)
    say("ended")


def _name(source: LiveSourceOptions) -> str:
    """Return the command with its sensors, marked as simulated if one is."""
    from rig.bench.live_source import FAKE

    return f"{mark(FAKE in source.sources)}rig live {' '.join(source.sources)}"


def _page(
    source: LiveSourceOptions, estimator: str | None, view: LiveViewOptions, stack: ExitStack
) -> "WatchPage":
    """Serve the page and open it, before anything that takes time."""
    from rig.live.watch import WatchPage, watch_address
    from rig.tactile.estimators import DEFAULT_ESTIMATOR, ESTIMATORS, TOSKOV

    names = dict.fromkeys([estimator or DEFAULT_ESTIMATOR, *ESTIMATORS])
    choices = [name for name in names if name != TOSKOV]
    page = WatchPage(watch_address(view.watch_at), _name(source), estimators=choices)
    stack.callback(page.close)
    say(f"live at {page.address}; Ctrl-C ends it")
    if view.browser:
        import webbrowser

        if not webbrowser.open(page.address):
            say("no browser opened: open that address in one on this computer")
    return page


def desk_of(
    source: LiveSourceOptions,
    how: LiveAngleOptions,
    stack: ExitStack,
    page: "WatchPage | None" = None,
    clips: Path = CLIPS,
) -> "Desk":
    """Return the sensors of the options, not connected yet. Raises `InputError`."""
    from rig.bench.live_source import SENSORS, live_sources
    from rig.live.desk import Desk
    from rig.live.feed import LiveFeed, Sender

    if len(source.sources) > 2:
        raise InputError(f"{len(source.sources)} sources: give one, or two that touch the same object")
    if source.sensor not in (None, *SENSORS):
        raise InputError(f"--sensor {source.sensor}: choose one of {', '.join(SENSORS)}")
    settings = _settings(source, how, clips)
    sender = Sender(LiveFeed(() if page is None else (page.listener,)))
    stack.callback(sender.close)
    return Desk(live_sources(source.sources, source.sensor, source.fps), settings, sender)


def _settings(source: LiveSourceOptions, how: LiveAngleOptions, clips: Path) -> "DeskSettings":
    from drivers.images import read_image
    from rig.frames.estimation import require_frames_suffice
    from rig.live.desk import DeskSettings
    from rig.tactile.estimators import choose_estimator

    choice = choose_estimator(how.estimator)
    require_frames_suffice(choice)
    background = None if how.background is None else read_image(how.background)
    signs = (1, 1) if source.same_side else (1, -1)
    return DeskSettings(choice, signs, background, how.pixel_aspect, clips)


@contextmanager
def stopped_by_person() -> Iterator[threading.Event]:
    """Yield an event that is set by Ctrl-C, a polite kill or a lost terminal; a second one ends the program.

    An error that is raised wherever the program is just then would leave the threads' locks in disorder.
    """
    stopped = threading.Event()

    def stop(*_: object) -> None:
        if stopped.is_set():
            raise OperatorStopError("stopped by the operator")
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
