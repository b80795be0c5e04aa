"""A hypothesis state machine of the gripper's commands, executed by the driver over the wire protocol."""

import time
from collections.abc import Callable

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from drivers.errors import DeviceError, GripperFaultError, NotConnectedError, OutOfLimitsError
from drivers.motion import Motion
from drivers.robotiq_3f.gripper import Robotiq3F, tcp_link
from fakes.wire.gripper.server import GripperServer
from support.finger_counts import opening_m
from support.gripper_on_wire import HurriedClock, raised_by, written
from support.worlds import empty_world

OPEN, CLOSED = 6, 255


class GripperRun(RuleBasedStateMachine):
    """Any order of commands: no unrequested motion, typed errors only, motions end at their targets."""

    def __init__(self) -> None:
        super().__init__()
        self.connected = self.activated = False
        self.at: int | None = OPEN
        """Known position of the fingers; None while they are, or may be, moving."""
        self.motion: Motion | None = None
        self.server = GripperServer(empty_world(), HurriedClock(20), activation_s=0.1)
        self.server.start()
        self.gripper = Robotiq3F(tcp_link(*self.server.address), speed_m_s=0.11)

    @rule()
    def connect(self) -> None:
        under_way = self.connected and self.motion is not None
        self.gripper.connect()
        if under_way:  # letting go stops them, also where the status did not show yet that they move
            state = self.gripper.state()
            assert not state.moving
            self.at = state.raw["position_counts"]
        self.connected, self.motion = True, None

    @rule()
    def disconnect(self) -> None:
        if self.connected and self.motion is not None:
            self.finish()
        self.gripper.disconnect()
        self.connected, self.motion = False, None

    @rule()
    def activate(self) -> None:
        if not self.connected:
            self.refuses(NotConnectedError, self.gripper.activate)
            return
        self.gripper.activate()
        self.activated, self.at, self.motion = True, OPEN, None

    @rule(position=st.one_of(st.integers(OPEN, CLOSED), st.integers(-3, 300)))
    def move(self, position: int) -> None:
        to_m = opening_m(self.gripper, position)
        if not self.connected:
            self.refuses(NotConnectedError, lambda: self.gripper.move_to(to_m))
        elif not self.activated:
            self.refuses(GripperFaultError, lambda: self.gripper.move_to(to_m), code=5)
        elif not OPEN <= position <= CLOSED:
            self.refuses(OutOfLimitsError, lambda: self.gripper.move_to(to_m))
        else:
            self.motion, self.at = self.gripper.move_to(to_m), None
            self.target = position

    @precondition(lambda self: self.motion is not None)
    @rule()
    def finish(self) -> None:
        assert self.motion is not None
        self.motion.wait(20.0)
        self.motion, self.at = None, self.target

    @precondition(lambda self: self.connected)
    @rule()
    def stop(self) -> None:
        self.gripper.stop()
        state = self.gripper.state()
        assert not state.moving
        if self.motion is not None:
            assert self.motion.is_done()
            self.at, self.motion = state.raw["position_counts"], None

    @rule()
    def pass_time(self) -> None:
        time.sleep(0.01)

    @invariant()
    def tells_the_truth(self) -> None:
        if not self.connected:
            self.refuses(NotConnectedError, self.gripper.state)
            return
        state = self.gripper.state()
        assert state.activated == self.activated
        assert state.opening_m == opening_m(self.gripper, state.raw["position_counts"])
        assert OPEN <= state.raw["position_counts"] <= CLOSED
        assert state.fault_code == 0
        if self.at is not None:
            assert not state.moving
            assert state.raw["position_counts"] == self.at

    def refuses(self, kind: type[DeviceError], call: Callable[[], object], code: int | None = None) -> None:
        with pytest.raises(kind) as raised:
            call()
        if code is not None:
            assert isinstance(raised.value, GripperFaultError)
            assert raised.value.code == code

    @precondition(lambda self: self.activated)
    @rule(code=st.sampled_from([0, 0x0D, 0x0E, 0x0F]))
    def fail(self, code: int) -> None:
        """Inject a fault, or (0) a loss of power: the activation is lost, which is an error when it is
        detected."""
        if not self.connected:
            self.connect()
        if self.motion is not None:
            self.finish()
        if code:
            self.server.inject("fault", code=code)
        else:
            self.server.inject("power_lost", duration_s=0.0)
        with pytest.raises(GripperFaultError) as raised:
            raise raised_by(self.gripper.state)
        assert raised.value.code == (code or 5)
        to_m = opening_m(self.gripper, 50)
        self.refuses(GripperFaultError, lambda: self.gripper.move_to(to_m), code=code or 5)
        self.refuses(GripperFaultError, self.gripper.state, code=code or 5)
        assert code or written(self.server) == bytes(16), "nothing is sent after a lost activation"
        self.activate()

    def teardown(self) -> None:
        self.gripper.disconnect()
        self.server.stop()


TestGripperOnTheWire = GripperRun.TestCase
TestGripperOnTheWire.settings = settings(max_examples=15, stateful_step_count=20, deadline=None)
