"""Where the bench of each lift comes from: a new one for each, or one that stands for the session."""

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Protocol

from drivers.bench import Bench, Hand
from drivers.errors import InputError
from drivers.realtime import compute_in_one_thread, realtime
from drivers.types import HandState, Holding
from fakes.world.world import World
from protocols.operator import Operator
from rig.bench.assembly import build_bench, build_real_bench
from rig.bench.hand_memory import HandMemory
from rig.bench.identity import prove_simulated
from rig.bench.operators import ConsoleOperator
from rig.bench.reading import read_devices, require_read
from rig.config import BenchConfig

SWITCH_S = 0.0005
"""How long one thread may keep the interpreter while a frame waits for another: Python's own 5 ms is a
third of the time between two frames."""


class BenchSource(Protocol):
    """Gives each lift (or pose) of a session its bench. Defaults: those of a new bench for each lift."""

    def begin(self) -> None:
        """Reach the bench, and ask whether to begin, before anything is kept of the session.

        Raises `DeviceError` for devices that cannot be reached, `OperatorStopError` unless agreed.
        """

    def for_lift(
        self, seed: int, lift: str, attempt: int = 0
    ) -> AbstractContextManager[tuple[Bench, Operator]]:
        """Give a connected bench and its operator. Raises `DeviceError`.

        seed: of what is drawn for this lift in a simulated world. lift, attempt: choose its
        scripted faults.
        """
        ...

    @property
    def after_fault(self) -> bool:
        """Whether a fault may have left the bench in any state."""
        return False

    def displaced(self) -> None:
        """Note that the object is no longer in its place."""


@dataclass(frozen=True, slots=True)
class FreshBenches(BenchSource):
    """A simulated bench of its own for each lift, in whatever process the lift runs.

    variation_seed: draws tactile sensors unlike those of a bench, the same for all lifts. watch: is given
    the world of each lift.
    """

    config: BenchConfig
    realtime: bool = False
    variation_seed: int | None = None
    watch: Callable[[World], None] | None = None

    @contextmanager
    def for_lift(self, seed: int, lift: str, attempt: int = 0) -> Iterator[tuple[Bench, Operator]]:
        """Make a bench, connect it, and let go of it after the lift."""
        bench, operator = build_bench(
            self.config, seed, lift, attempt, self.realtime, self.variation_seed, self.watch
        )
        with bench.connected():
            yield bench, operator


class StandingBench(BenchSource):
    """One bench for a whole session: opened when the first lift needs it, anew after a fault.

    person: who is asked; first of all, with `introduction`, whether to begin. Where the bench's
    devices prove to be fakes behind a wire, nobody is asked, and objects are laid into their world.
    What the hand does is remembered, so that the next program knows what this one left in it.
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
        """Whether the last lift ended badly: fingers may be closed, the arm may be anywhere."""
        return self._after_fault

    def begin(self) -> None:
        """Read every device, ask whether to begin, and connect; nothing moves."""
        bench = self._bench or self._open()
        with realtime():
            self._connect(bench)

    @contextmanager
    def for_lift(self, seed: int, lift: str, attempt: int = 0) -> Iterator[tuple[Bench, Operator]]:
        """Give the one bench; whatever goes wrong in a lift, the next one connects anew.

        While it lasts, the lift goes before other programs of the computer, where it may.
        """
        bench = self._bench or self._open()
        with realtime():
            self._connect(bench)
            try:
                yield bench, self._person if self._simulated is None else self._simulated(seed)
            except BaseException:
                self._after_fault = True
                self._let_go()
                raise
        self._after_fault = False
        if self._memory is not None and bench.hand.state.holding is Holding.FREE:
            self._memory.keep_untouched(bench)

    def displaced(self) -> None:
        """Have the object laid down anew before the next lift."""
        self._person.displaced()

    def close(self) -> None:
        """Disconnect, and stop the fakes that were started for this session."""
        self._let_go()
        self._session.close()

    def _connect(self, bench: Bench) -> None:
        if not self._connected:
            self._connection.enter_context(bench.connected())
            self._connected = True
            self._look_at_fingertips(bench)

    def _open(self) -> Bench:
        config = self._session.enter_context(_reached(self._config))
        sys.setswitchinterval(SWITCH_S)
        compute_in_one_thread()
        bench = build_real_bench(config, self._remembered_hand(config))
        if config.fakes is None:
            readings = read_devices(bench)
            require_read(readings)
            seen = "\n".join(f"  {reading.device}: {reading.seen}" for reading in readings)
            self._person.confirm(f"Devices, looked at and let go again:\n{seen}\n{self._introduction}")
        else:
            from rig.bench.fakes_process import simulated_operator

            self._simulated = partial(simulated_operator, config)
        self._bench = bench
        return bench

    def _remembered_hand(self, config: BenchConfig) -> Hand:
        """What the last program knew of the hand; of fakes that were started for this one, nothing was.

        A bench without arm and gripper has no hand.
        """
        started = self._config.fakes is not None and self._config.fakes.control is None
        if started or not (config.has("arm") or config.has("gripper")):
            return Hand(HandState(Holding.FREE))
        host = config.arm.host if config.has("arm") else None
        self._memory = memory = HandMemory(host or f"bench {config.name}")
        return Hand(memory.recall(), memory.keep)

    def _look_at_fingertips(self, bench: Bench) -> None:
        """A hand that was free when the last program ended may not be, where its fingertips look touched."""
        if self._memory is None or bench.hand.state.holding is not Holding.FREE:
            return
        if touched := self._memory.touched(bench):
            bench.hand.note(HandState(Holding.UNKNOWN, f"{' and '.join(touched)} look touched"))

    def _let_go(self) -> None:
        self._connected = False
        self._connection.close()


@contextmanager
def _reached(config: BenchConfig) -> Iterator[BenchConfig]:
    """Start the fakes of a bench file unless it names running ones; yield the bench with their addresses.

    A bench without fakes is yielded as it is. Raises `InputError` if its fakes do not serve all devices.
    """
    with ExitStack() as stack:
        if config.fakes is not None and config.fakes.control is None:
            from rig.bench.fakes_process import started_fakes

            config = stack.enter_context(started_fakes(config))
        if config.fakes is not None:
            prove_simulated(config)
        yield config


@contextmanager
def unconnected_bench(config: BenchConfig) -> Iterator[Bench]:
    """Make a bench for reading, in real time; fakes behind wires run until the block ends."""
    if config.in_process:
        yield build_bench(config, realtime=True)[0]
        return
    with _reached(config) as reached:
        yield build_real_bench(reached)


@contextmanager
def session_bench(
    config: BenchConfig,
    person: ConsoleOperator,
    introduction: str,
    realtime: bool = False,
    variation_seed: int | None = None,
) -> Iterator[BenchSource]:
    """Return where a session's lifts get their bench, and close it after the session.

    variation_seed: as in `FreshBenches`. Raises `InputError` where it is given for another bench, and
    for a bench that says of itself that it is simulated, and is not.
    """
    if config.in_process:
        yield FreshBenches(config, realtime, variation_seed)
        return
    if variation_seed is not None:
        raise InputError(f"--randomise: bench '{config.name}' has sensors of its own; use --bench fake")
    if config.fakes is not None and config.fakes.control is not None:
        prove_simulated(config)
    standing = StandingBench(config, person, introduction)
    try:
        yield standing
    finally:
        standing.close()
