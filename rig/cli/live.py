"""`rig live`, `rig bridge`: show or publish the angle of one or two sensors live, without a bench."""

import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from drivers.clock import SystemClock, to_ns
from drivers.errors import EstimatorError, InputError
from drivers.realtime import compute_in_one_thread
from rig.cli.common import NO_BROWSER, STOPS, Exit, mark, say
from rig.cli.helping import Commands
from rig.declared import argument, option
from rig.terminal.screen import show_display

if TYPE_CHECKING:
    from rig.live.desk import Desk
    from rig.live.desk_sensor import Reading
    from rig.live.feed import Listener
    from rig.live.watch import WatchPage

bridge = Commands(
    no_args_is_help=True, help="Publish live angles, alarms and images for other robot software."
)
CLIPS = Path("clips")
TERMINAL_EVERY_S = 0.1
"""Interval at which the lines on a terminal are updated."""
SHOW_CURSOR = b"\x1b[?25h"
"""Escape sequence (DECTCEM, VT220) that undoes what a display of rich's does to the cursor."""
PLAIN_EVERY_S = 1.0
"""Interval of the lines per sensor if the output is not a terminal."""


@dataclass(frozen=True)
class DeskOptions:
    sources: list[str] = argument(
        ...,
        "One or two sensors: a DIGIT's serial, /dev/videoN or its number, an MJPEG address (http://...), or "
        "fake (simulated).",
    )
    sensor: str | None = option(
        None,
        "Kind of sensor: digit; gelsight-mini (opened at its own resolution, cropped to the gel); or plain "
        "(frames are used unchanged). Default: digit for a serial or a device, else plain.",
    )
    fps: float | None = option(None, "Frame rate in Hz. Default: that of the sensor.", min=0.1, max=1000.0)
    same_side: bool = option(
        False, "Both sensors touch the object on the same side. Default: on opposite sides, as fingers do."
    )
    estimator: str | None = option(None, "Estimator, as in rig estimate. Default: slip.")
    background: Path | None = option(
        None,
        "Frame without contact. Default: the mean of the first 15 frames; nothing may touch the gel then.",
    )
    pixel_aspect: float | None = option(
        None,
        "Width of a pixel on the gel divided by its height. Default: 1 is assumed, with a larger sigma.",
        min=0.5,
        max=2.0,
    )
    gel: Path | None = option(
        None, "YAML file of rig calibrate tactile: slip computes slopes from its look. For one sensor."
    )


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """Where a page is served, and whether it is opened."""

    browser: bool = option(True, "Open the page in the browser.", "--browser/--no-browser")
    watch_at: str | None = option(
        None,
        "HOST:PORT of the page. With 0.0.0.0:8080 other computers can use it, at the address with a key that "
        "the command prints. Default: a free port that only this computer can reach.",
    )


@dataclass(frozen=True)
class LiveOptions(PageOptions, DeskOptions):
    terminal: bool = option(False, "Show the angle as text in the terminal, without a page.")
    json: bool = option(False, "Print one JSON object per frame on stdout, without a page.")
    clips: Path = option(CLIPS, "Folder for recorded clips.")
    seconds: float | None = option(None, "End after this time in s. Default: run until Ctrl-C.", min=0.0)


def live(options: LiveOptions) -> None:
    """Show the angle of one or two tactile sensors live, in the browser, as text or as JSON.

    No bench is needed, and nothing moves. Ctrl-C ends the command.

    The page shows the frame of each sensor with the outline of the contact; the angle with its sigma over
    time; state, rate, slip alarm, frame rate and latency. The angles of two sensors are fused. The first
    frames become the background. The angle is relative to the frame in which the contact has settled.

    The page has buttons to take a new reference or background, to switch the estimator, to set a mark (key
    m), and to record a clip for rig show, rig label-angle, rig estimate and rig benchmark clips, or to save
    the last 30 s.

    The page keeps the last 10 minutes: each angle (at most 36,000 frames), 5 images per second and a list of
    events. A slider shows any moment. This takes up to 70 MB of memory per sensor; the frames of the last 30
    s take up to 256 MB, about 30 MB if the sensor sends JPEG.

    Examples:
      rig live fake
      rig live D20641 --no-browser
      rig live /dev/video2 --sensor gelsight-mini
      rig live http://127.0.0.1:8080/stream.mjpg --json
      rig live D20641 D20642 --background empty.png
      rig live fake fake --terminal --seconds 10
    """
    from rig.live.watch import WatchPage, watch_address

    if options.watch_at is not None and (options.terminal or options.json):
        raise InputError("--watch-at is the address of the page: leave it out, or --terminal and --json")
    at = watch_address(options.watch_at)
    require_sensors(options.sources)
    title = f"{mark(is_simulated(options.sources))}rig live {' '.join(options.sources)}"
    with stop_event() as stopped, ExitStack() as stack:
        page = None
        if not options.terminal and not options.json:  # its process starts while this one imports the rest
            page = stack.enter_context(
                closing(WatchPage(at, title, estimators=choosable_estimators(options.estimator)))
            )
        desk = desk_of(options, stack, options.clips, () if page is None else (page.listener,))
        begin_showing(title, page, options.browser, stack)
        compute_in_one_thread()
        stack.enter_context(desk)
        run_desk(desk, stack.enter_context(open_view(options, stopped)), options.seconds, stopped, page)
        if desk.fault is not None:
            raise EstimatorError(f"ended; the estimator failed: {desk.fault}")
        notice = desk.notice
    # The summaries of sources that have ended were printed then.
    lines = [] if desk.has_ended else [f"{sensor.name}: {sensor.summary}" for sensor in desk.sensors.values()]
    if desk.notice != notice:  # a clip that was being saved, or why it is not
        lines.append(desk.notice)
    say("\n".join([*lines, "ended"]))


def require_sensors(sources: Sequence[str]) -> None:
    """Raise `InputError` if a source is stored."""
    from rig.bench.live_source import is_stored

    for text in filter(is_stored, sources):
        raise InputError(
            f"{text} is stored, and rig live is for sensors: rig show {text} shows it on the page, "
            f"rig estimate {text} prints its angles"
        )


def begin_showing(title: str, page: "WatchPage | None", browser: bool, stack: ExitStack) -> None:
    """Print the title and the address of the page, if there is one, and open it in the browser if wanted.

    The stack then removes the file that names a secret address.
    """
    import webbrowser

    from rig.pages.requests import way_to

    say(f"{title}{'' if page is None else f' at {page.address}'}; press Ctrl-C to end")
    if page is None or not browser:
        return
    secret = bool(page.process.access.key)
    if not webbrowser.open(stack.enter_context(way_to(page.address)) if secret else page.address):
        say(NO_BROWSER)


@contextmanager
def open_view(options: LiveOptions, stopped: threading.Event) -> "Iterator[Callable[[Reading], None]]":
    """Yield a function that prints a reading as JSON or text; with a page it does nothing."""
    if options.json:
        yield partial(print_json, stopped)
    elif options.terminal:
        with terminal_view() as show:
            yield show
    else:
        yield lambda reading: None


def is_simulated(sources: Sequence[str]) -> bool:
    """Whether a source is simulated, or a clip of a simulated sensor. Raises `InputError`."""
    from rig.bench.live_source import FAKE
    from rig.frames.clips import is_simulated_clip

    return any(text == FAKE or is_simulated_clip(Path(text)) for text in sources)


def choosable_estimators(estimator: str | None) -> tuple[str, ...]:
    """Return the estimators that the user can choose from. estimator: named on the command line."""
    from rig.tactile.estimators import DEFAULT_ESTIMATOR, ESTIMATORS, TOSKOV

    names = dict.fromkeys([estimator or DEFAULT_ESTIMATOR, *ESTIMATORS])
    return tuple(name for name in names if name != TOSKOV)


def desk_of(
    options: DeskOptions,
    stack: ExitStack,
    folder: Path = CLIPS,
    listeners: "Sequence[Listener]" = (),
) -> "Desk":
    """Return the desk of the options; its sensors are not connected yet.

    folder: for the clips that are recorded. listeners: viewers that its messages go to. Raises `InputError`,
    `DeviceError`.
    """
    from drivers.images import read_image
    from rig.bench.live_source import SENSORS, is_stored, live_sources, serial_of
    from rig.frames.estimates import require_frames_suffice
    from rig.frames.series import read_frames
    from rig.live.desk import Desk, DeskSettings
    from rig.live.feed import Sender
    from rig.tactile.estimators import choose_estimator

    texts = options.sources
    if len(texts) > 2:
        raise InputError(f"{len(texts)} sources: give one, or two sensors that touch the same object")
    if options.sensor not in (None, *SENSORS):
        raise InputError(f"--sensor {options.sensor}: choose one of {', '.join(SENSORS)}")
    clips = {text: read_frames(Path(text), fps=options.fps) for text in texts if is_stored(text)}
    for note in (note for clip in clips.values() for note in clip.notes):
        say(note)
    sources = live_sources(texts, options.sensor, options.fps, clips)
    if options.gel is not None and len(texts) > 1:
        raise InputError("--gel is for one sensor: leave it out, or give one source")
    choice = choose_estimator(options.estimator, gel=options.gel)
    require_frames_suffice(choice)
    given = None if options.background is None else read_image(options.background)
    own = {text: clip.empty() for text, clip in clips.items() if given is None and clip.empty is not None}
    settings = DeskSettings(
        choice,
        signs=(1, 1) if options.same_side else (1, -1),
        backgrounds=tuple(own.get(text, given) for text in texts),
        aspect=options.pixel_aspect,
        clips=folder,
        serials=tuple(map(serial_of, texts)),
        simulated=is_simulated(texts),
        estimators=choosable_estimators(options.estimator),
    )
    sender = Sender(listeners)
    stack.callback(sender.close)
    return Desk(sources, settings, sender)


@contextmanager
def stop_event() -> Iterator[threading.Event]:
    """Yield an event that SIGINT (Ctrl-C), SIGQUIT, SIGTERM and SIGHUP set; a second signal ends the program.

    The first signal raises no exception, because that could leave locks of other threads held, and because
    Python has crashed at exit while threads were inside a camera's driver.
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
    """Process frames until `stopped` is set, the time is over, or, without a page, all sources have ended.

    show: called with each reading. seconds: time limit in s; None for no limit. page: whose buttons are
    handled.
    """
    clock, notice = SystemClock(), ""
    end_ns = None if seconds is None else clock.now_ns() + to_ns(seconds)
    while not stopped.is_set() and (end_ns is None or clock.now_ns() < end_ns):
        for reading in desk.step():
            show(reading)
        if page is not None and (action := page.take_action()) is not None:
            desk.act(action)
        if desk.notice != notice:
            notice = desk.notice
            say(notice)
        if desk.has_ended and page is None:
            return


def print_json(stopped: threading.Event, reading: "Reading") -> None:
    """Print a reading as one line of JSON; set `stopped` if the reader has gone, as after `| head`."""
    print(json.dumps(reading.values()), flush=True)
    if getattr(sys.stdout, "reader_gone", False):
        stopped.set()


@contextmanager
def terminal_view() -> "Iterator[Callable[[Reading], None]]":
    """Yield a function that prints a line per sensor: updated on a terminal, else a new one every second."""
    from rich.live import Live

    from rig.live.feed import NO_FRAMES
    from rig.terminal.tables import PlainConsole

    lines, due_ns, console = dict[str, str](), dict[str, int](), PlainConsole()
    display = Live(console=console, auto_refresh=False) if console.is_terminal else None
    every_ns = to_ns(PLAIN_EVERY_S if display is None else TERMINAL_EVERY_S)

    def show(reading: "Reading") -> None:
        if reading.time_ns < due_ns.get(reading.name, 0) and reading.state != NO_FRAMES:
            return
        due_ns[reading.name], lines[reading.name] = reading.time_ns + every_ns, reading.line()
        if display is None:
            print(lines[reading.name], flush=True)
        else:
            display.update("\n".join(lines.values()), refresh=True)

    with nullcontext() if display is None else show_display(display):
        yield show


@dataclass(frozen=True)
class BridgeOptions(DeskOptions):
    sources: list[str] = argument(
        ...,
        "One or two sources: a sensor as in rig live, or a clip, a video or a folder of images, which is "
        "played as a sensor, at its frame rate or at 60 Hz.",
    )
    # 232: highest domain whose port numbers fit into 16 bits (RTPS 2.5, section 9.6.2)
    domain: int = option(
        0,
        "ROS domain of the nodes. Default: the environment variable ROS_DOMAIN_ID, else 0.",
        min=0,
        max=232,
        envvar="ROS_DOMAIN_ID",
    )
    seconds: float | None = option(None, "End after this time in s. Default: run until Ctrl-C.", min=0.0)


@bridge.command("ros2")
def ros2(options: BridgeOptions) -> None:
    """Publish images, angle and slip alarm of one or two sensors for ROS 2 nodes.

    ROS need not be installed on this computer. Nothing moves. Ctrl-C ends the command.

    The topics of a sensor are /NAME/image_raw/compressed (CompressedImage), /angle/NAME (JointState: angle,
    angle_sigma, angle_rate in rad and rad/s; NaN if unknown) and /slip/NAME (Bool). Two sensors also publish
    /angle/object and /slip/object. Time stamps are capture times. The angle is that of rig live.

    The messages reach all computers on the network interface that Cyclone DDS selects. Set its environment
    variable CYCLONEDDS_URI to select another interface.

    Examples:
      rig bridge ros2 fake
      rig bridge ros2 D20641 D20642 --domain 7
      rig bridge ros2 http://127.0.0.1:8080/stream.mjpg --background empty.png
    """
    from rig.config.extras import require_extra

    for package in ("cyclonedds", "rosbags"):
        require_extra(package, "ros2", "the bridge needs")
    with stop_event() as stopped, ExitStack() as stack:
        from rig.live.ros2_bridge import Ros2Bridge

        compute_in_one_thread()
        desk = stack.enter_context(desk_of(options, stack))
        publisher = Ros2Bridge(options.domain, SystemClock())
        topics = ", ".join(publisher.topics([*desk.sensors]))
        marked = mark(is_simulated(options.sources))
        say(f"{marked}publishing in domain {options.domain}: {topics}; press Ctrl-C to end")
        run_desk(desk, publisher.publish, options.seconds, stopped)
    say(f"ended: {publisher.published} messages published")
