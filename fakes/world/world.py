"""The world of a simulated bench, which all its simulated devices read and change.

It holds the state of the tool, the fingers and the object, and simulates the contact between them. Only
simulated devices may read it; protocols, drivers and estimators get only what a sensor would measure.
"""

import math
import threading
from collections import deque

import numpy as np

from drivers.clock import NS_PER_S
from drivers.errors import DeviceError
from drivers.types import Pose, Vector3
from fakes.objects.catalogue import GraspSite, ObjectModel, find_object
from fakes.world.fixture import HOLE_FROM_TABLE_M, Fixture, parse_fixture, tip_m
from fakes.world.motion import FingerPath, ToolPath, tool_tilt
from fakes.world.state import (
    GRAVITY,
    BenchLayout,
    Grasp,
    GripLoad,
    LiftVariation,
    SlipDynamics,
    WorldState,
    between,
    hand_turn_rad,
    object_pose,
)

STEP_NS = 2_000_000
HISTORY_STEPS = 1500
FINGER_STIFFNESS_N_M = 420.0
"""Force per metre of squeeze: one count of 0.6 mm adds about a quarter of a newton per finger."""
STALL_FORCE_N = 15.0
"""Lowest force that can be commanded (manual: rFR = 0 is 15 N); the fingers stall at it."""
SWAY = 0.04
"""Relative amplitude of the oscillation of the force while the object hangs."""
REACH_OF_GRASP_M = 0.03
"""Largest distance of the tool from a grasp site at which the fingers grasp it, along x and z."""
_OFF_DIGITS = 6
"""Offsets of a grasp are rounded to this number of digits, to micrometres."""


class World:
    """Tool, fingers, object and contact, simulated in steps of 2 ms.

    It is thread-safe; `tool` and `fingers` are immutable and replaced as a whole. layout: of the bench. seed:
    of the variation of a lift. start_ns: bench time at which the world begins.
    """

    def __init__(self, layout: BenchLayout, seed: int, start_ns: int = 0) -> None:
        self.layout, self._lock = layout, threading.RLock()
        self.tool = ToolPath.resting(layout.home)
        self.fingers = FingerPath.resting(float(layout.open_counts))
        self._grasp_height_m = self._grasp_tilt_rad = 0.0
        first = WorldState(start_ns, 0.0, 0.0, tool_tilt(layout.home), 0.0, 0.0, 0.0, False)
        self._history = deque([first], maxlen=HISTORY_STEPS)
        self.place(None, seed)

    def lay(self, text: str, seed: int | None = None) -> None:
        """Place an object on the table or mount a target, as the operator would.

        text: an object's id or name, or a target with its mount ("...@tool"). seed: of the object's pose,
        slip and tilt; None to keep the current seed. Raises `InputError`.
        """
        fixture = parse_fixture(text)
        self.place(None if fixture else find_object(text), seed)
        self.fixture = fixture

    def place(self, model: ObjectModel | None, seed: int | None = None) -> None:
        """Place an object on the table at the position of the bench file; None clears the table.

        seed: of the object's pose, slip and tilt; None to keep the current seed.
        """
        with self._lock:
            if seed is not None:
                self.seed, self._rng = seed, np.random.default_rng(seed)
                self.variation = LiftVariation.from_rng(self._rng)
            self.model: ObjectModel | None = model
            self.grasp: Grasp | None = None
            self.fixture: Fixture | None = None
            self._slip: SlipDynamics | None = None
            self._slips_ns: list[tuple[int, int]] = []
            self._turned_by_hand = self.damaged = False
            """damaged: whether the fingers have marked the object. No sensor measures it."""

    def hold(
        self,
        text: str,
        base_T_tcp: Pose,  # noqa: N803
        opening_m: float | None = None,
        turning: bool = False,
    ) -> None:
        """Put tool and fingers at a pose with something between them, as when an operator holds it there.

        text: as for `lay`. opening_m: between the gels, which press the object if it is wider; None for open
        fingers. turning: whether the operator turns the object to and fro between the gels. Raises
        `InputError`.
        """
        self.lay(text)
        with self._lock:
            self._turned_by_hand = turning
            layout = self.layout
            closed_m = 0.0 if opening_m is None else layout.max_opening_m - opening_m
            self.tool = ToolPath.resting(base_T_tcp)
            self.fingers = FingerPath.resting(layout.open_counts + closed_m / layout.opening_per_count_m)

    def opening_at(self, time_ns: int) -> float:
        """Return the distance between the two grasping fingertips, m."""
        closed = self.fingers.position_at(time_ns) - self.layout.open_counts
        return self.layout.max_opening_m - closed * self.layout.opening_per_count_m

    def squeeze_at(self, time_ns: int) -> float:
        """Return how far the fingers are closed beyond the object's surface, m; 0 without contact."""
        grasp = self.grasp  # read once: another thread may replace it
        site = grasp.site if grasp else self._reachable_site(time_ns)
        if site is None:
            return 0.0
        width = site.width_m + (0.0 if site.contact.exact else self.variation.width_error_m)
        return max(0.0, width - self.opening_at(time_ns))

    def state_at(self, time_ns: int) -> WorldState:
        """Return the state at `time_ns`, at most 3 s ago; advance the world if necessary."""
        with self._lock:
            return self._state_at(time_ns)

    def grip_at(self, time_ns: int) -> tuple[WorldState, GripLoad] | None:
        """Return the state at `time_ns` and the load on the grip; None if nothing is held."""
        with self._lock:
            state = self._state_at(time_ns)
            if not state.held or self.model is None or self.grasp is None:
                return None
            return state, self._load(self.model, self.grasp.site, state.force_n)

    def object_pose_at(self, time_ns: int) -> Pose:
        """Return `base_T_object`: origin at the centre of mass, x along the object, z up."""
        with self._lock:
            state = self._state_at(time_ns)
            return object_pose(self.layout, self.variation, self.grasp, state, self.tool.position_at(time_ns))

    def tool_pose_at(self, time_ns: int) -> Pose:
        return self.tool.pose_at(time_ns)

    def gap_at(self, time_ns: int) -> Vector3:
        """Return the vector from the clamped tip to the hole on the table, in the base's axes, m."""
        base_T_tcp = self.tool.pose_at(time_ns)  # noqa: N806 - frame names keep their case
        tip = base_T_tcp.rotation.apply(tip_m(self.seed)) + np.asarray(base_T_tcp.position_m)
        x, y, z = (np.add(self.layout.base_T_table.position_m, HOLE_FROM_TABLE_M) - tip).tolist()
        return x, y, z

    def _state_at(self, time_ns: int) -> WorldState:
        while self._history[-1].time_ns < time_ns:
            self._history.append(self._step(self._history[-1].time_ns + STEP_NS))
        newest = self._history[-1].time_ns
        index = len(self._history) - 1 - (newest - time_ns + STEP_NS - 1) // STEP_NS
        if index < 0:
            raise DeviceError("simulated world: asked for a time more than 3 s in the past")
        if newest == time_ns or index + 1 >= len(self._history):
            return self._history[-1]
        return between(self._history[index], self._history[index + 1], time_ns)

    def _reachable_site(self, time_ns: int) -> GraspSite | None:
        """Return the grasp site of the placed object that is between the fingers; None if there is none."""
        if self.model is None:
            return None
        x, _, z = self.tool.position_at(time_ns)
        table_x, _, table_z = self.layout.base_T_table.position_m
        if abs(z - table_z) > REACH_OF_GRASP_M:
            return None
        nearest = min(self.model.sites, key=lambda site: abs(table_x + site.offset_m - x))
        off = abs(table_x + nearest.offset_m - x)
        return nearest if off <= REACH_OF_GRASP_M else None

    def _step(self, time_ns: int) -> WorldState:
        wrist = self.tool.tilt_at(time_ns)
        squeeze = self.squeeze_at(time_ns)
        if squeeze <= 0.0 or self.model is None:
            self.grasp, self._slip = None, None
            return WorldState(time_ns, 0.0, 0.0, wrist, 0.0, 0.0, 0.0, False)
        if self._slip is None:
            self._close_on_object(time_ns, wrist)
        return self._step_held(time_ns, squeeze, wrist)

    def _close_on_object(self, time_ns: int, wrist_rad: float) -> None:
        site = self._reachable_site(time_ns)
        self._slip = SlipDynamics(self._rng, creep_rad=math.radians(self._rng.uniform(0.0, 0.3)))
        x, _, z = self.tool.position_at(time_ns)
        table_x, _, table_z = self.layout.base_T_table.position_m
        if site is not None:
            off_m = round(x - (table_x + site.offset_m), _OFF_DIGITS), round(z - table_z, _OFF_DIGITS)
            self.grasp = Grasp(site, off_m)
        self._grasp_height_m, self._grasp_tilt_rad = z, wrist_rad

    def _step_held(self, time_ns: int, squeeze_m: float, wrist_rad: float) -> WorldState:
        slip, model, grasp = self._slip, self.model, self.grasp
        if slip is None or model is None or grasp is None:
            raise DeviceError("simulated world: an object is held, but not at a grasp site")
        height = max(0.0, self.tool.position_at(time_ns)[2] - self._grasp_height_m)
        loaded = min(height / 0.015, 1.0)
        sway = SWAY * loaded * math.sin(2 * math.pi * 0.9 * time_ns / NS_PER_S + self.variation.sway_phase)
        force = FINGER_STIFFNESS_N_M * squeeze_m * (1.0 + self.variation.force_shift * loaded + sway)
        self.damaged |= model.marked_above_n is not None and force > model.marked_above_n
        slip.step(self._load(model, grasp.site, force), height, STEP_NS / NS_PER_S)
        if slip.slipping or slip.fallen:
            goes_on = self._slips_ns and self._slips_ns[-1][1] == time_ns - STEP_NS
            began_ns = self._slips_ns.pop()[0] if goes_on else time_ns
            self._slips_ns.append((began_ns, time_ns))
        if slip.fallen:
            return WorldState(time_ns, 0.0, slip.angle_rad, wrist_rad, 0.0, slip.slide_m, 0.0, False)
        turn = slip.angle_rad + wrist_rad - self._grasp_tilt_rad
        if self._turned_by_hand:
            turn += hand_turn_rad(time_ns)
        return WorldState(time_ns, force, turn, wrist_rad, slip.torsion_rad, slip.slide_m, loaded, True)

    def would_hold(self, offset_m: float, beyond_counts: int) -> bool:
        """Return whether friction would hold the placed object without slip as long as it hangs.

        offset_m: of the grasp from the centre of mass. beyond_counts: counts that the fingers close beyond
        contact, unless they stall or reach their end before. Raises `DeviceError` if no object is placed.
        """
        with self._lock:
            if self.model is None:
                raise DeviceError("simulated world: no object is placed")
            site = min(self.model.sites, key=lambda each: abs(each.offset_m - offset_m))
            layout = self.layout
            free_counts = (layout.max_opening_m - site.width_m) / layout.opening_per_count_m
            reachable = layout.closed_counts - layout.open_counts - free_counts
            squeeze_m = max(0.0, min(beyond_counts, reachable)) * layout.opening_per_count_m
            pushed_n = min(FINGER_STIFFNESS_N_M * squeeze_m, STALL_FORCE_N)
            least_n = pushed_n * (1.0 + self.variation.force_shift - SWAY)
            return self._load(self.model, site, least_n).holds_turn()

    def slipped_between(self, since_ns: int, until_ns: int) -> bool:
        """Whether the object slipped in the fingers, or fell out of them, between two times."""
        with self._lock:
            return any(began <= until_ns and ended >= since_ns for began, ended in self._slips_ns)

    def _load(self, model: ObjectModel, site: GraspSite, force_n: float) -> GripLoad:
        left_end = model.com_from_left_m + site.offset_m
        right_end = model.length_m - left_end
        return GripLoad(
            force_n=force_n,
            weight_n=model.mass_kg * GRAVITY,
            friction=model.friction * self.variation.friction_factor,
            patch_radius_m=0.004,
            lever_m=site.offset_m,
            reach_m=max(left_end if site.offset_m > 0 else right_end, 0.02),
        )
