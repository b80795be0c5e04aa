"""What each command number of ur-rtde's control program does (scripts/rtde_control.script, 1.6.5).

In freedrive (teach_mode, freedrive_mode) a scripted hand may lead the arm (`fakes.wire.ur.guiding`). Not
modelled: force mode and external force sensors are accepted and change nothing; torques, mass matrix and
Coriolis terms read zero.
"""

from collections.abc import Callable

from drivers.types import Vector6
from fakes.wire.ur.body import STILL, JointMove, LinearMove, ServoMove, SpeedMove
from fakes.wire.ur.control_loop import Command, ControlLoop, Thread
from fakes.wire.ur.frames import Frame, compose, from_ur, to_ur
from fakes.wire.ur.guiding import Guided
from fakes.wire.ur.kinematics import forward
from fakes.wire.ur.robot import CYCLE_S, Robot

FORCE_MODE_BRAKE = 10.0
FREEDRIVE_BRAKE = 2.0
JOG_BRAKE = 1.2


def _move_j(loop: ControlLoop) -> Thread:
    return _joint_move(loop, loop.joints(0))


def _move_j_ik(loop: ControlLoop) -> Thread:
    return _joint_move(loop, loop.robot.solved(loop.frame(0)))


def _joint_move(loop: ControlLoop, target: Vector6) -> Thread:
    speed, acceleration = loop.doubles(6, 2)
    return loop.move([JointMove(loop.robot.body.q, loop.robot.allowed(target), speed, acceleration)])


def _move_l(loop: ControlLoop) -> Thread:
    loop.robot.solved(loop.frame(0))
    return _linear_move(loop, loop.frame(0))


def _move_l_fk(loop: ControlLoop) -> Thread:
    return _linear_move(loop, loop.robot.tcp_at(loop.robot.allowed(loop.joints(0))))


def _linear_move(loop: ControlLoop, target: Frame) -> Thread:
    speed, acceleration = loop.doubles(6, 2)
    return loop.move([LinearMove(loop.robot.body.tcp, target, speed, acceleration)])


def _move_path(loop: ControlLoop) -> Thread:
    return loop.move(loop.path())


def _speed(joint: bool) -> Command:
    def start(loop: ControlLoop) -> None:
        body = loop.robot.body
        mover = body.mover
        if not isinstance(mover, SpeedMove) or mover.joint is not joint:
            body.mover = mover = SpeedMove(body.qd if joint else body.twist, joint)
        mover.target, (mover.acceleration,) = loop.joints(0), loop.doubles(6, 1)

    return start


def _jog_start(loop: ControlLoop) -> None:
    feature = round(loop.doubles(6, 1)[0])
    axes = (from_ur(STILL), loop.robot.body.tcp, loop.frame(8))[feature if feature in (1, 2) else 0]
    linear, turning = (
        compose((0.0, 0.0, 0.0, *axes[3:]), (*part, *from_ur(STILL)[3:]))[:3]
        for part in (loop.doubles(0, 3), loop.doubles(3, 3))
    )
    body = loop.robot.body
    mover = body.mover if isinstance(body.mover, SpeedMove) else SpeedMove(body.twist, joint=False)
    mover.target, (mover.acceleration,) = (*linear, *turning), loop.doubles(7, 1)  # type: ignore[assignment]
    body.mover = mover


def _servo_j(loop: ControlLoop) -> None:
    _servo(loop, loop.robot.allowed(loop.joints(0)))


def _servo_l(loop: ControlLoop) -> None:
    _servo(loop, loop.robot.solved(loop.frame(0)))


def _servo(loop: ControlLoop, target: Vector6) -> None:
    body = loop.robot.body
    if not isinstance(body.mover, ServoMove):
        body.mover = ServoMove(body.qd, target)
    body.mover.target = target
    body.mover.lookahead_s, body.mover.gain = loop.doubles(9, 2)


def _servo_c(loop: ControlLoop) -> None:
    loop.robot.solved(loop.frame(0))
    speed, acceleration = loop.doubles(6, 2)
    loop.robot.body.mover = LinearMove(loop.robot.body.tcp, loop.frame(0), speed, acceleration)


def _speed_stop(loop: ControlLoop) -> Thread:
    mover = loop.robot.body.mover
    return loop.brake(loop.doubles(0, 1)[0], linear=not (isinstance(mover, SpeedMove) and mover.joint))


def _brake(rate: float | None = None) -> Command:
    return lambda loop: loop.brake(loop.doubles(0, 1)[0] if rate is None else rate, linear=True)


def _stop(loop: ControlLoop) -> Thread:
    return loop.stop()


def _until_contact(loop: ControlLoop) -> Thread:
    body = loop.robot.body
    mover = SpeedMove(body.twist, joint=False)
    mover.target, (mover.acceleration,) = loop.joints(0), loop.doubles(12, 1)
    body.mover = mover
    while not (cycles := loop.robot.contact_cycles()) and body.mover is mover:
        yield
    yield from loop.return_to_contact(cycles)


def _stop_contact_watch(loop: ControlLoop) -> None:
    loop.watch_contact(on=False)
    loop.answer_integer(loop.contact_cycles)


def _payload(loop: ControlLoop) -> None:
    mass, *cog = loop.doubles(0, 4)
    loop.robot.load(mass, tuple(cog) if any(cog) else None)


def _target_payload(loop: ControlLoop) -> None:
    _payload(loop)
    loop.robot.bank.set("payload_inertia", loop.doubles(4))


def _set_tcp(loop: ControlLoop) -> None:
    loop.robot.set_tool(loop.frame(0))


def _answer(values: Callable[[ControlLoop], tuple[float, ...]]) -> Command:
    return lambda loop: loop.answer(values(loop))


def _tell(value: Callable[[ControlLoop], int]) -> Command:
    return lambda loop: loop.answer_integer(value(loop))


def _inverse_near(loop: ControlLoop) -> tuple[float, ...]:
    return loop.robot.solved(loop.frame(0), loop.joints(6))


def _forward_of(loop: ControlLoop) -> tuple[float, ...]:
    return to_ur(compose(forward(loop.joints(0)), loop.frame(6)))


def _pose_trans(loop: ControlLoop) -> tuple[float, ...]:
    return to_ur(compose(loop.frame(0), loop.frame(6)))


def _matrix(columns: Callable[[Robot], tuple[tuple[float, ...], ...]]) -> Command:
    """Column by column into registers 0 to 23, then 36 to 47; since 5.23."""

    def write(loop: ControlLoop) -> None:
        if loop.robot.version >= (5, 23, 0, 0):
            values = [v for column in columns(loop.robot) for v in column]
            loop.answer(values[:24])
            loop.answer(values[24:], first=36)

    return write


def _zeros(_: Robot) -> tuple[tuple[float, ...], ...]:
    return (STILL,) * 6


def _free(loop: ControlLoop) -> None:
    """teach_mode, or freedrive_mode along and about some of the axes of a frame: always the base's here."""
    loop.robot.body.mover = Guided(loop.robot.hand)


def _free_axes(loop: ControlLoop) -> None:
    loop.robot.body.mover = Guided(loop.robot.hand, tuple(bool(loop.integer(i)) for i in range(1, 7)))


def _hold(loop: ControlLoop) -> Thread | None:
    """Back to position control: the arm brakes where it is. Without freedrive nothing happens."""
    return loop.brake(FREEDRIVE_BRAKE, linear=True) if isinstance(loop.robot.body.mover, Guided) else None


COMMANDS: dict[int, Command] = {
    1: _move_j,
    2: _move_j_ik,
    3: _move_l,
    4: _move_l_fk,
    7: _brake(FORCE_MODE_BRAKE),
    8: lambda loop: loop.robot.zero_force_sensor(),
    9: _speed(joint=True),
    10: _speed(joint=False),
    11: _servo_j,
    12: _servo_c,
    15: _speed_stop,
    16: _brake(),
    17: _payload,
    18: _free,
    19: _hold,
    24: _servo_l,
    25: _tell(lambda loop: loop.robot.contact_cycles()),
    26: _answer(lambda _: (CYCLE_S,)),
    27: _answer(lambda loop: loop.robot.joints_before(loop.integer(1))),
    28: _answer(lambda loop: to_ur(loop.robot.body.tcp)),
    29: _set_tcp,
    30: _answer(_inverse_near),
    31: lambda loop: loop.robot.protective_stop(),
    33: _stop,
    34: _stop,
    35: lambda loop: loop.robot.watch(f"input_int_register_{loop.program.offset}", loop.doubles(0, 1)[0]),
    36: _tell(lambda loop: loop.robot.reachable(loop.frame(0))),
    37: _tell(lambda loop: loop.robot.within_limits(loop.joints(0))),
    38: _answer(lambda _: STILL),
    39: _answer(_pose_trans),
    40: _answer(lambda loop: to_ur(loop.robot.body.tool)),
    41: _jog_start,
    42: _brake(JOG_BRAKE),
    43: _answer(lambda loop: to_ur(loop.robot.body.tcp)),
    44: _answer(_forward_of),
    45: _move_path,
    46: _answer(lambda loop: loop.robot.solved(loop.frame(0))),
    47: _tell(lambda loop: loop.robot.steady()),
    51: _until_contact,
    52: _free_axes,
    53: _hold,
    54: _tell(lambda _: 0),
    58: _answer(lambda loop: to_ur(loop.robot.body.flange)),
    60: _tell(lambda loop: loop.robot.reachable(loop.frame(0))),
    61: _tell(lambda loop: loop.robot.reachable(loop.frame(0))),
    62: lambda loop: loop.watch_contact(on=True),
    63: _stop_contact_watch,
    64: _tell(lambda loop: loop.contact_cycles),
    65: _target_payload,
    67: _matrix(_zeros),
    68: _matrix(lambda _: (STILL,)),
    69: _matrix(lambda robot: (robot.body.qdd,)),
    70: _matrix(lambda robot: robot.jacobian()),
    71: _matrix(_zeros),
}
"""Numbers that are not here are accepted and do nothing."""
