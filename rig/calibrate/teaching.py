"""Teach the grasp positions of an object: move the hand there, measure the position, check all limits."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from drivers.bench import Bench
from drivers.errors import OutOfLimitsError
from drivers.types import HandState, Holding, Pose
from protocols.grasps import GraspFile, Position
from protocols.operator import Operator
from protocols.readiness import make_ready
from protocols.safe_end import safe_end
from protocols.steps import TRAVEL_SPEED_M_S, go_home, home_plan, require_room, way_to
from protocols.teach import STEP_SPEED_M_S, Taught, lead_by_hand, measure_width, open_hand, step_by_keys
from rig.bench.assembly import TOOL_DOWN, home_pose
from rig.bench.operators import ConsoleOperator
from rig.bench.plan import Plan, PlannedMotion, make_plan
from rig.bench.source import session_bench
from rig.bench.twins import refuse_undrawn
from rig.calibrate.bench import TouchObserver
from rig.config import BenchConfig
from rig.config.messages import faults_of
from rig.experiments.lift_plan import grasp_pose

BESIDE_M = 0.010
"""Largest distance of the hand from the mark along the closing direction; the fingers centre the object."""
TILTED_DEG = 3.0
USUAL_LIFT_M = 0.05


@dataclass(frozen=True, slots=True)
class Lesson:
    """The positions to teach. positions: their names; new ones are added.

    by_hand: the arm is led by hand, else moved in steps by keys. limit_s: longest time in which the arm
    can be led. lift_height_m: asked at the bench if None.
    """

    config: BenchConfig
    grasps: GraspFile
    positions: tuple[str, ...]
    by_hand: bool
    limit_s: float
    lift_height_m: float | None = None


@dataclass(frozen=True, slots=True)
class TaughtPosition:
    """One position measured at the bench. problems: reasons not to write it; empty if it can be written."""

    name: str
    values: dict[str, float]
    problems: tuple[str, ...]


def teaching_plan(lesson: Lesson) -> Plan:
    """Return what will move. Raises `InputError` for an object that a simulated bench cannot draw."""
    refuse_undrawn(lesson.config, lesson.grasps)
    way = (
        f"you lead the arm by hand, for {lesson.limit_s:g} s at most"
        if lesson.by_hand
        else f"you step the arm by keys, at {STEP_SPEED_M_S:g} m/s"
    )
    return make_plan(
        lesson.config,
        [
            home_plan(home_pose(lesson.config), "First, and after each position,"),
            f"At each of {', '.join(lesson.positions)}: the fingers open wide; {way}; the fingers close "
            "count by count until both fingertips touch, and open again.",
        ],
        [],
    )


def teach(
    lesson: Lesson, person: ConsoleOperator, say: Callable[[str], None], seed: int = 0
) -> list[TaughtPosition]:
    """Measure the positions at the bench and return them; nothing is written yet.

    Raises `OperatorStopError` if the person does not agree, and `DeviceError`. The arm then holds its
    position.
    """
    text = f"{teaching_plan(lesson).text()}\nBegin?"
    with session_bench(lesson.config, person, text) as benches, benches.for_lift(seed, "teach") as place:
        bench, operator = place
        make_ready(bench, operator, benches.after_fault)
        operator.place(lesson.grasps.id, lesson.grasps.name)
        found = []
        for name in lesson.positions:
            found.append(_teach_one(lesson, name, bench, operator))
            v = found[-1].values
            summary = (
                f"'{name}': {1e3 * v['offset_m']:+.1f} mm along the object, {1e3 * v['height_m']:+.1f} mm "
                f"over the mark, turned by {v['turn_deg']:+.1f} deg, {1e3 * v['width_m']:.1f} mm wide, "
                f"lifted by {1e3 * v['lift_height_m']:.0f} mm"
            )
            say("; ".join([summary, *found[-1].problems]))
        return found


def _teach_one(lesson: Lesson, name: str, bench: Bench, operator: Operator) -> TaughtPosition:
    known = next((p for p in lesson.grasps.position if p.name == name), None)
    where = grasp_pose(bench.base_T_table, known or Position(name=name, offset_m=0.0, width_m=0.03), 0.0)
    operator.look(f"Position '{name}': the fingers will open wide. Is the space around them clear?")
    open_hand(bench)
    _bring(lesson, bench, operator, f"Bring the open fingers around {lesson.grasps.name} at '{name}'.", where)
    operator.look("The fingers will close, step by step, until both fingertips touch. Close them?")
    taught = measure_width(
        bench, TouchObserver(tuple(t.sensor.serial for t in bench.fingertips)), lesson.grasps.name
    )
    lift_m = lesson.lift_height_m
    if lift_m is None:
        top = taught.base_T_grasp.translated(z_m=(known.lift_height_m if known else 0.0) or USUAL_LIFT_M)
        said = "Bring the hand straight up to the end of a lift; the object stays on the table."
        risen = _bring(lesson, bench, operator, said, top)
        lift_m = risen.position_m[2] - taught.base_T_grasp.position_m[2]
    with safe_end(bench):
        go_home(bench)
        bench.hand.note(HandState(Holding.FREE, finger_opening_m=bench.gripper.state().opening_m))
    return assess_grasp(lesson.config, name, taught, lift_m)


def _bring(lesson: Lesson, bench: Bench, operator: Operator, question: str, where: Pose) -> Pose:
    if not lesson.by_hand:
        return step_by_keys(bench, operator, question, where)
    operator.look(f"{question} The arm will then follow your hand: hold it now. Continue?")
    return lead_by_hand(bench, operator, question, where, lesson.limit_s)


def assess_grasp(config: BenchConfig, name: str, taught: Taught, lift_m: float) -> TaughtPosition:
    """Return the entry of an object file for a grasp, and the problems with it."""
    mark_m = config.require("table").position_m
    x, y, z = (float(v) for v in np.subtract(taught.base_T_grasp.position_m, mark_m))
    x_axis = taught.base_T_grasp.rotation.apply([1.0, 0.0, 0.0])
    turn_deg = float(np.degrees(np.arctan2(x_axis[2], x_axis[0])))
    straight = Rotation.from_euler("y", -turn_deg, degrees=True) * TOOL_DOWN
    tilt_deg = float(np.degrees((straight.inv() * taught.base_T_grasp.rotation).magnitude()))
    values = {
        "offset_m": round(x, 4), "height_m": round(z, 4), "turn_deg": round(turn_deg, 1),
        "width_m": round(taught.width_m, 4), "lift_height_m": round(max(lift_m, 0.0), 4),
    }  # fmt: skip
    problems = []
    if abs(y) > BESIDE_M:
        problems.append(f"the hand stands {1e3 * y:+.0f} mm beside the mark; lay the object on its mark")
    if tilt_deg > TILTED_DEG:
        problems.append(f"the hand is tilted by {tilt_deg:.1f} degrees; grasps point straight down")
    try:
        place = Position.model_validate({"name": name, **values})
    except ValidationError as error:
        faults = (f"{'.'.join(map(str, key))}: {why}" for key, why in faults_of(error, Position))
        return TaughtPosition(name, values, (*problems, *faults))
    # why a trial would refuse this position: reach, limits, table, boxes; room for the fingers
    grasp = grasp_pose(Pose(mark_m), place, 0.0)
    way = (*way_to(home_pose(config), grasp), grasp.translated(z_m=place.lift_height_m))
    problems += make_plan(config, [], [PlannedMotion(name, grasp, way, TRAVEL_SPEED_M_S)]).refused
    try:
        require_room(config.gripper_spec(), place.width_m)
    except OutOfLimitsError as error:
        problems.append(str(error))
    return TaughtPosition(name, values, tuple(problems))
