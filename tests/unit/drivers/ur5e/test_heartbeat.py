"""How long a motion may go on unwatched, by its speed, and what stops it then."""

from types import SimpleNamespace

import pytest

from drivers.clock import SystemClock, to_ns
from drivers.ur5e.heartbeat import BRAKE_M_S2, LONGEST_S, MOST_WAY_M, Heartbeat, silence_limit_s
from drivers.ur5e.shared_state import SharedState


@pytest.mark.parametrize("speed_m_s", [0.001, 0.05, 0.1, 0.15, 0.25, 0.3])
def test_an_unwatched_motion_stands_within_its_way(speed_m_s: float) -> None:
    limit_s = silence_limit_s(speed_m_s)
    assert limit_s <= LONGEST_S
    assert limit_s * speed_m_s + speed_m_s**2 / (2 * BRAKE_M_S2) <= MOST_WAY_M


class Control:
    """A controller with a motion that goes on until it is stopped."""

    def __init__(self) -> None:
        self.running, self.stops = True, 0

    def getAsyncOperationProgressEx(self) -> SimpleNamespace:  # noqa: N802
        return SimpleNamespace(isAsyncOperationRunning=lambda: self.running)

    def stopL(self, deceleration: float, asynchronous: bool) -> None:  # noqa: N802
        self.stops += 1


def test_a_motion_is_stopped_once_when_nobody_looks_and_never_while_somebody_does() -> None:
    control, state, clock = Control(), SharedState(), SystemClock()
    heartbeat = Heartbeat(control, state)
    heartbeat.check()
    heartbeat.begin(0.25)
    for _ in range(20):
        state.look(clock.now_ns())
        clock.sleep_until(clock.now_ns() + to_ns(0.005))
        heartbeat.check()
    assert (control.stops, heartbeat.silence_s) == (0, 0.0)
    clock.sleep_until(clock.now_ns() + to_ns(silence_limit_s(0.25)))
    heartbeat.check()
    heartbeat.check()
    assert control.stops == 1
    assert heartbeat.silence_s > silence_limit_s(0.25)
    heartbeat.begin(0.25)
    assert heartbeat.silence_s == 0.0
    control.running = False  # arrived unseen: there is nothing to stop
    clock.sleep_until(clock.now_ns() + to_ns(0.1))
    heartbeat.check()
    assert (control.stops, heartbeat.silence_s) == (1, 0.0)
    state.close()
