"""Provide the bench of each lift: a new simulated one per lift, or one bench for the whole session.

The bench of a session is read before the first question; the state of its hand survives a killed program.
"""

import fcntl
import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext, suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Protocol
from urllib.parse import quote

from drivers.bench import Bench, Hand
from drivers.errors import DeviceError, FormatError, InputError, InvalidStateError, RecordingError, plural
from drivers.formats import read_json
from drivers.images import encode_png, load_image
from drivers.interfaces import FrameSource
from drivers.realtime import compute_in_one_thread, realtime
from drivers.types import HandState, Holding, Pose
from fakes.world.world import World
from protocols.grasps import find_grasp_file
from protocols.operator import Operator
from protocols.readiness import check_hand
from rig.bench.assembly import build_bench, build_real_bench
from rig.bench.findings import first_findings
from rig.bench.identity import prove_simulated
from rig.bench.operators import ConsoleOperator
from rig.config import BenchConfig
from rig.sessions.files import state_folder, write_file, write_json
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.contact.gate import TOUCH_FRAMES

FRAME_S = 1.0
"""Largest age of a stored frame, and time limit for the next one."""
_log = logging.getLogger("rig.bench.hand")


class HandMemory:
    """Stores the state of one arm's hand, and the no-contact frames of its fingertips.

    arm: the address of the arm that the hand is on.
    """

    def __init__(self, arm: str) -> None:
        self._folder = state_folder() / "hands"
        self._arm, self._name = arm, quote(arm, safe="")
        self._file = self._folder / f"{self._name}.json"

    def recall(self) -> HandState:
        """Return the last stored state; unknown if none was stored, or it cannot be read.

        Raises `RecordingError` if the folder cannot be written.
        """
        state = self._read()
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise self._unwritable(error) from error
        self._write(state)
        return state

    @contextmanager
    def reserve(self) -> Iterator[None]:
        """Reserve the arm and its hand for this program; the system releases them when it ends in any way.

        A second program would end the control program of the first, whose object then stays in the air.
        Raises `DeviceError` if another program has reserved them, `RecordingError` as `recall` does.
        """
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            lock = (self._folder / f"{self._name}.lock").open("w")
        except OSError as error:
            raise self._unwritable(error) from error
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise DeviceError(
                    f"{self._arm}: another rig program uses this bench; wait for its end, then start again"
                ) from error
            yield

    def keep(self, state: HandState) -> None:
        """Store the state. A failure is only logged, because the hand continues its motion."""
        try:
            self._write(state)
        except RecordingError as error:
            _log.warning("%s", error)

    def keep_untouched(self, bench: Bench) -> None:
        """Store the current no-contact frame of each fingertip; skip fingertips without a frame."""
        for tip in bench.fingertips:
            with suppress(DeviceError, RecordingError):
                write_file(self._picture(tip.sensor), encode_png(tip.sensor.newest_frame(FRAME_S).image))

    def tips_in_contact(self, bench: Bench) -> list[str]:
        """Return the serials of fingertips that show contact, compared with the stored no-contact frames."""
        found: list[str] = []
        for sensor in (tip.sensor for tip in bench.fingertips):
            before = load_image(self._picture(sensor))
            if before is None:
                continue
            finder = ContactFinder(before)
            with suppress(DeviceError):  # reported later, when the sensor's frames are needed
                frames = (sensor.next_frame(FRAME_S).image for _ in range(TOUCH_FRAMES))
                if all(finder.find(image).mask is not None for image in frames):
                    found.append(sensor.serial)
        return found

    def _unwritable(self, error: OSError) -> RecordingError:
        return RecordingError(
            f"{self._folder}: cannot be written ({error.strerror}): it stores what the hand holds "
            "across crashes; set XDG_STATE_HOME to a writable folder"
        )

    def _write(self, state: HandState) -> None:
        write_json(self._file, {**asdict(state), "holding": state.holding.value})

    def _read(self) -> HandState:
        try:
            values = read_json(self._file)
            place = values["base_T_grasp"]
            parts = place and (tuple(place["position_m"]), tuple(place["quaternion_xyzw"]))
            pose = None if place is None else Pose(*parts)
            what, width_m = str(values["what"]), float(values["width_m"])
            return HandState(Holding(values["holding"]), what, pose, width_m, values["finger_opening_m"])
        except (FormatError, InvalidStateError, ValueError, KeyError, TypeError, OverflowError):
            if not self._file.exists():
                return HandState(Holding.UNKNOWN, "no run has stored it yet")
            return HandState(Holding.UNKNOWN, f"{self._file} is damaged")

    def _picture(self, sensor: FrameSource) -> Path:
        return self._folder / f"{self._name}-{quote(sensor.serial, safe='')}.png"


SWITCH_S = 0.0005
"""Longest time that one thread keeps the interpreter while another waits; Python's default of 5 ms is a third
of the time between two frames."""


class BenchSource(Protocol):
    """Provides the bench for each lift (or pose) of a session. Defaults: a new bench for each lift."""

    def begin(self) -> None:
        """Connect the bench, and ask whether to begin, before anything of the session is stored.

        Raises `DeviceError` for devices that cannot be reached, `OperatorStopError` unless a person agrees.
        """

    def for_lift(
        self, seed: int, lift: str, attempt: int = 0
    ) -> AbstractContextManager[tuple[Bench, Operator]]:
        """Return a connected bench and its operator. Raises `DeviceError`.

        seed: of the random values of this lift in a simulated world. lift, attempt: select its scripted
        faults.
        """
        ...

    @property
    def after_fault(self) -> bool:
        """Whether a fault may have left the bench in any state."""
        return False

    def note_displaced(self) -> None:
        """Note that the object is no longer in its place."""

    def place_first(self, object_id: str, why: str) -> None:
        """Have the first object of a resumed session placed before anything moves, if that is needed.

        why: why it may not lie in its place according to the session; "" if the last attempt set it down
        there. Raises `OperatorStopError` unless a person or a feeder places it.
        """


@dataclass(frozen=True, slots=True)
class FreshBenches(BenchSource):
    """Provides a new simulated bench for each lift, in the process in which the lift runs.

    variation_seed: draws tactile sensors that differ from the bench's own, the same for all lifts. watch:
    called with the world of each lift.
    """

    config: BenchConfig
    realtime: bool = False
    variation_seed: int | None = None
    watch: Callable[[World], None] | None = None

    @contextmanager
    def for_lift(self, seed: int, lift: str, attempt: int = 0) -> Iterator[tuple[Bench, Operator]]:
        bench, operator = build_bench(
            self.config, seed, lift, attempt, self.realtime, self.variation_seed, self.watch
        )
        with bench.connection():
            yield bench, operator


class StandingBench(BenchSource):
    """Provides one bench for a whole session: opened for the first lift, reconnected after a fault.

    person: is asked, first of all, with `introduction`, whether to begin. If the bench's devices prove to be
    fakes over the wire protocol, nobody is asked, and objects are put into their world. The state of the hand
    is stored for the next program.
    """

    def __init__(self, config: BenchConfig, person: ConsoleOperator, introduction: str) -> None:
        self._config = config
        self._person = person
        self._introduction = introduction
        self._bench: Bench | None = None
        self._memory: HandMemory | None = None
        self._simulated: Callable[[int], Operator] | None = None
        self._session = ExitStack()
        self._connection = ExitStack()
        self._connected = False
        self._after_fault = False

    @property
    def after_fault(self) -> bool:
        """Whether the last lift ended with an error: fingers may be closed, the arm may be anywhere."""
        return self._after_fault

    def begin(self) -> None:
        """Read every device, ask whether to begin, and connect; nothing moves."""
        bench = self._bench or self._open()
        with realtime():
            self._connect(bench)

    @contextmanager
    def for_lift(self, seed: int, lift: str, attempt: int = 0) -> Iterator[tuple[Bench, Operator]]:
        """Return the session's bench; after any error in a lift, the next one reconnects.

        The lift runs at real-time priority, if permitted.
        """
        bench = self._bench or self._open()
        with realtime():
            self._connect(bench)
            try:
                yield bench, self._person if self._simulated is None else self._simulated(seed)
            except BaseException:
                self._after_fault = True
                self._disconnect()
                raise
        self._after_fault = False
        if self._memory is not None and bench.hand.state.holding is Holding.FREE:
            self._memory.keep_untouched(bench)

    def note_displaced(self) -> None:
        self._person.note_displaced()

    def place_first(self, object_id: str, why: str) -> None:
        """As in `BenchSource`; an object that the hand held when the last run ended also has to be placed.

        A hand that may still hold an object is asked about before the first motion (`protocols.readiness`),
        and the object is placed after that.
        """
        bench = self._bench
        if bench is None or self._simulated is not None or not self._config.has("arm"):
            return
        known, hand = bench.hand.state, check_hand(bench)
        if known.holding is Holding.HELD:
            why = why or f"the hand held {known.what or 'an object'} when the last run ended"
        if why:
            self._person.note_displaced(why)
        if why and hand.holding is Holding.FREE:
            self._person.place(object_id, find_grasp_file(object_id, self._config.objects).name)

    def close(self) -> None:
        """Disconnect, and stop the fakes that were started for this session."""
        self._disconnect()
        self._session.close()

    def _connect(self, bench: Bench) -> None:
        if not self._connected:
            self._connection.enter_context(bench.connection())
            self._connected = True
            # fingertips that show contact: a hand that was free may hold an object
            if self._memory is not None and bench.hand.state.holding is Holding.FREE:
                if touched := self._memory.tips_in_contact(bench):
                    bench.hand.note(HandState(Holding.UNKNOWN, f"{' and '.join(touched)} show contact"))

    def _open(self) -> Bench:
        config = self._session.enter_context(_start_fakes(self._config))
        sys.setswitchinterval(SWITCH_S)
        compute_in_one_thread()
        bench = build_real_bench(config, self._remembered_hand())
        if config.fakes is None:
            findings = first_findings(bench, config)
            if failed := [finding for finding in findings if finding.failed]:
                devices = plural(len({finding.device for finding in findings}), "device")
                raise DeviceError(
                    f"{len(failed)} of {devices} cannot be used, nothing was started: "
                    f"{'; '.join(map(str, failed))}; rig doctor gives details"
                )
            seen = "\n".join(f"  {finding}" for finding in findings)
            self._person.confirm(f"Devices were read and disconnected again:\n{seen}\n{self._introduction}")
        else:
            from rig.bench.fakes_process import simulated_operator

            self._simulated = partial(simulated_operator, config, bench.clock)
        self._bench = bench
        return bench

    def _remembered_hand(self) -> Hand:
        """Return the hand's state stored by the last program; free if fakes are started for this session.

        A bench without arm and gripper has no hand.
        """
        self._memory = memory = _memory_of(self._config)
        if memory is None:
            return Hand(HandState(Holding.FREE))
        self._session.enter_context(memory.reserve())
        return Hand(memory.recall(), memory.keep)

    def _disconnect(self) -> None:
        self._connected = False
        self._connection.close()


@contextmanager
def _start_fakes(config: BenchConfig) -> Iterator[BenchConfig]:
    """Start the fakes of a bench file unless some are running already; yield the bench with their addresses.

    A bench without fakes is yielded as it is. Raises `InputError` if its fakes do not serve all devices.
    """
    with ExitStack() as stack:
        if config.fakes is not None and config.fakes.control is None:
            from rig.bench.fakes_process import started_fakes

            config = stack.enter_context(started_fakes(config))
        if config.fakes is not None:
            prove_simulated(config)
        yield config


def _memory_of(config: BenchConfig) -> HandMemory | None:
    """Return the memory of a bench's hand; None without arm and gripper, and for fakes of this program."""
    started = config.in_process or (config.fakes is not None and config.fakes.control is None)
    if started or not (config.has("arm") or config.has("gripper")):
        return None
    return HandMemory(getattr(config.arm, "host", None) or f"bench {config.name}")


def reserve_bench(config: BenchConfig) -> AbstractContextManager[None]:
    """Reserve arm and hand of a bench for this program, see `HandMemory.reserve`, if other programs can."""
    memory = _memory_of(config)
    return nullcontext() if memory is None else memory.reserve()


@contextmanager
def unconnected_bench(config: BenchConfig) -> Iterator[Bench]:
    """Create a bench for reading, in real time; fakes over the wire protocol run until the block ends."""
    if config.in_process:
        yield build_bench(config, realtime=True)[0]
        return
    with _start_fakes(config) as reached:
        yield build_real_bench(reached)


@contextmanager
def session_bench(
    config: BenchConfig,
    person: ConsoleOperator,
    introduction: str,
    realtime: bool = False,
    variation_seed: int | None = None,
) -> Iterator[BenchSource]:
    """Return the bench source of a session, and close it after the session.

    variation_seed: as in `FreshBenches`. Raises `InputError` if it is given for another kind of bench, and
    for a bench with [fakes] that is not simulated.
    """
    if config.in_process:
        yield FreshBenches(config, realtime, variation_seed)
        return
    if variation_seed is not None:
        raise InputError(f"--randomise: bench '{config.name}' has fixed sensors; use --bench fake")
    if config.fakes is not None and config.fakes.control is not None:
        prove_simulated(config)
    standing = StandingBench(config, person, introduction)
    try:
        yield standing
    finally:
        standing.close()
