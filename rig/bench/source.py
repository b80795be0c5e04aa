"""Provide the bench of each lift: a new simulated one per lift, or one bench for the whole session."""

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

    def displaced(self) -> None:
        """Note that the object is no longer in its place."""


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
        with bench.connected():
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

    def displaced(self) -> None:
        self._person.displaced()

    def close(self) -> None:
        """Disconnect, and stop the fakes that were started for this session."""
        self._disconnect()
        self._session.close()

    def _connect(self, bench: Bench) -> None:
        if not self._connected:
            self._connection.enter_context(bench.connected())
            self._connected = True
            self._check_fingertips(bench)

    def _open(self) -> Bench:
        config = self._session.enter_context(_reached(self._config))
        sys.setswitchinterval(SWITCH_S)
        compute_in_one_thread()
        bench = build_real_bench(config, self._remembered_hand(config))
        if config.fakes is None:
            readings = read_devices(bench)
            require_read(readings)
            seen = "\n".join(f"  {reading.device}: {reading.seen}" for reading in readings)
            self._person.confirm(f"Devices were read and disconnected again:\n{seen}\n{self._introduction}")
        else:
            from rig.bench.fakes_process import simulated_operator

            self._simulated = partial(simulated_operator, config, bench.clock)
        self._bench = bench
        return bench

    def _remembered_hand(self, config: BenchConfig) -> Hand:
        """Return the hand's state stored by the last program; free if fakes are started for this session.

        A bench without arm and gripper has no hand.
        """
        started = self._config.fakes is not None and self._config.fakes.control is None
        if started or not (config.has("arm") or config.has("gripper")):
            return Hand(HandState(Holding.FREE))
        host = config.arm.host if config.has("arm") else None
        self._memory = memory = HandMemory(host or f"bench {config.name}")
        return Hand(memory.recall(), memory.keep)

    def _check_fingertips(self, bench: Bench) -> None:
        """Set a hand that was free to unknown if fingertips now show contact."""
        if self._memory is None or bench.hand.state.holding is not Holding.FREE:
            return
        if touched := self._memory.touched(bench):
            bench.hand.note(HandState(Holding.UNKNOWN, f"{' and '.join(touched)} show contact"))

    def _disconnect(self) -> None:
        self._connected = False
        self._connection.close()


@contextmanager
def _reached(config: BenchConfig) -> Iterator[BenchConfig]:
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


@contextmanager
def unconnected_bench(config: BenchConfig) -> Iterator[Bench]:
    """Create a bench for reading, in real time; fakes over the wire protocol run until the block ends."""
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
