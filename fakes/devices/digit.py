"""A simulated DIGIT on a finger; its gel shows the held object of the simulated world."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from drivers.clock import NS_PER_S, Clock
from drivers.interfaces import TactileSensor
from drivers.types import Image
from fakes.devices.camera import CameraPlan, FakeSource, Shutter, unit_seed
from fakes.faults import FaultScript
from fakes.gel.dots import shear_of
from fakes.gel.pad import rotate
from fakes.gel.sensor import GelSensor, Imprint
from fakes.gel.variation import FAMILY, Look, apply_codec, draw_variation, jpeg
from fakes.objects.surfaces import Surface, depth_for_force, face_surface
from fakes.studio.conditions import EASY, Conditions, Difficulty, draw_conditions
from fakes.world.mirror import WorldView
from fakes.world.state import PAD_M, SLIDE_M_PER_RAD, BenchLayout, Grasp, WorldState

_FORCE_GRID_N = np.array([0.02, 0.05, 0.1, 0.2, 0.4, 0.7, 1.0, 1.4, 1.9, 2.6, 4.0, 15.0])


_gel = lru_cache(maxsize=8)(GelSensor)
"""Cached, because making the gel of a sensor takes as long as rendering fifty frames."""


@dataclass(frozen=True, slots=True)
class DigitPlan:
    """Description of a fingertip, which can be sent to another process.

    side: +1 if it looks in the direction of the camera, else -1. number: index from 0, which sets the phase
    of its frames. variation_seed: seed of a sensor with random properties; None for a typical sensor.
    markers: whether dots are printed on its gel. difficulty: of its lifts; a hard lift has its own gel and
    light, instead of the sensor's. look: of a real sensor, used in every lift; None for a made-up light.
    """

    serial: str
    side: int
    rate_hz: float
    number: int
    variation_seed: int | None = None
    markers: bool = False
    difficulty: Difficulty = "easy"
    look: Look | None = None

    def for_lift(self, seed: int) -> "DigitPlan":
        """Return the fingertip with its frame rate in the lift of a seed; some video codecs reduce it."""
        given_hz = draw_conditions(self.difficulty, seed, self.side).rate_hz
        return self if given_hz is None else replace(self, rate_hz=min(given_hz, self.rate_hz))

    def make(self, world: WorldView, clock: Clock, faults: FaultScript) -> "FakeDigit":
        return FakeDigit(self, world, clock, faults)


class FakeDigit(FakeSource, TactileSensor):
    """A DIGIT with its own gel. Its individual properties depend on the serial only, not on the bench."""

    def __init__(self, plan: DigitPlan, world: WorldView, clock: Clock, faults: FaultScript) -> None:
        shutter = Shutter(plan.rate_hz, phase_s=0.002 + 0.005 * plan.number)
        noise_seed = world.seed * 8 + 4 + plan.side
        super().__init__((plan.serial, "tactile"), shutter, self.draw, clock, faults, noise_seed)
        seed = plan.variation_seed
        self._unit, self._variation = unit_seed(plan.serial), FAMILY
        if seed is not None:
            self._unit = unit_seed(f"{plan.serial}/{seed}")
            self._variation = draw_variation(np.random.default_rng((seed, plan.number)))
        self._world, self._plan, self._side = world, plan, plan.side
        self._pressed: tuple[object, Surface, np.ndarray] | None = None
        self._light = 1.0

    def set_light(self, red: float, green: float, blue: float) -> None:
        """Scale the light by the mean of the three values: the simulated LEDs have a common supply."""
        self._light = (red + green + blue) / 3.0

    def draw(self, time_ns: int, rng: np.random.Generator) -> Image:
        state = self._world.state_at(time_ns)
        image, look = self._gel.render(self._imprint(state), time_ns / NS_PER_S, rng), self._plan.look
        if self._conditions.codec is not None:
            image = apply_codec(image, time_ns, self._conditions.codec)
        elif look is not None and look.jpeg_quality is not None:
            image = jpeg(image, look.jpeg_quality)
        if self._light == 1.0:
            return image
        return np.clip(image * self._light, 0, 255).astype(np.uint8)

    def true_mask(self, time_ns: int) -> Image:
        """Return the true contact mask at `time_ns` (at most 3 s ago), (H, W) uint8, 0 or 255."""
        return self._gel.touching(self._imprint(self._world.state_at(time_ns)))

    @property
    def _conditions(self) -> Conditions:
        return draw_conditions(self._plan.difficulty, self._world.seed, self._side)

    @property
    def _gel(self) -> GelSensor:
        varied = self._conditions is EASY or self._variation is not FAMILY
        unit = self._variation if varied else self._conditions.unit
        return _gel(self._unit, unit, self._plan.markers, self._plan.look)

    def _surface(self, grasp: Grasp) -> tuple[Surface, np.ndarray]:
        """Return the surface in contact, and its depths in mm for the forces `_FORCE_GRID_N`."""
        key = (grasp, self._world.seed)
        if self._pressed is None or self._pressed[0] != key:
            kind, bulge = self._conditions.face(grasp.site.contact)
            surface = face_surface(grasp.site, kind, self._side, self._world.seed)
            at = {"centre_mm": self._off_mm(grasp), "bulge": bulge}
            depths = np.array([depth_for_force(surface, float(force), **at) for force in _FORCE_GRID_N])
            self._pressed = (key, surface, depths)
        return self._pressed[1], self._pressed[2]

    def _imprint(self, state: WorldState) -> Imprint | None:
        grasp = self._world.grasp
        if not state.held or state.force_n <= 0.0 or grasp is None:
            return None
        surface, depths = self._surface(grasp)
        side, variation, conditions = self._side, self._world.variation, self._conditions
        turn, slid_mm = state.object_turn_rad - state.wrist_rad, state.slide_m * 1e3
        # the total rotation since the grasp, from the slide that accompanies it
        slipped_rad = min(state.slide_m, PAD_M) / SLIDE_M_PER_RAD
        off_x, off_y = self._off_mm(grasp)
        right, low = (place * 1e3 for place in variation.misplacement_m)
        px, py = variation.pivot_mm
        shear, bulge, bulge_mm = None, conditions.face(grasp.site.contact)[1], (0.0, 0.0)
        if self._plan.markers:  # shear of the gel's surface since the fingers closed
            pivot = side * (right + px) + off_x, low + py + off_y
            shear = shear_of(math.degrees(side * turn), pivot, (0.0, slid_mm))
        # the surface turns about a pivot beside the centre of the contact
        x, y = rotate(px, py, turn)
        across, down = right + px - x, low + py - y + slid_mm
        if bulge is not None:  # it slides and rocks with the object, but never turns; the face rolls
            (roll_x, roll_y), (rock_x, rock_y) = conditions.roll_mm_per_rad, conditions.rock_mm_per_rad
            across, down = across + roll_x * slipped_rad, down + roll_y * slipped_rad
            bulge_down = (variation.misplacement_m[1] + state.slide_m) * 1e3 + rock_y * slipped_rad
            bulge_mm = side * (right + rock_x * slipped_rad) + off_x, bulge_down + off_y
        # the tilt is fixed to the object, and grows with the weight on the pads
        (rest_x, rest_y), (load_x, load_y) = variation.tilt_at_rest, variation.tilt_under_load
        tilt_x, tilt_y = rotate(rest_x + state.loaded * load_x, rest_y + state.loaded * load_y, turn)
        force_n = state.force_n
        if not grasp.site.contact.exact:
            force_n *= conditions.pressed_more(math.degrees(slipped_rad))
        return Imprint(
            surface=surface,
            angle_deg=math.degrees(side * turn),
            centre_mm=(side * across + off_x, down + off_y),
            depth_mm=float(np.interp(force_n, _FORCE_GRID_N, depths)),
            tilt=(side * tilt_x, tilt_y),
            lag_deg=math.degrees(side * state.torsion_rad),
            shear=shear,
            bulge=bulge,
            bulge_mm=bulge_mm,
        )

    def _off_mm(self, grasp: Grasp) -> tuple[float, float]:
        """Return the grasp site's position on the gel, x right, y down; (0, 0) if the hand closed on it."""
        off_x, off_z = grasp.off_m
        return -self._side * off_x * 1e3, off_z * 1e3


@dataclass(frozen=True, slots=True)
class BenchPlan:
    """Description of a simulated bench, which can be sent to another process."""

    layout: BenchLayout
    digits: tuple[DigitPlan, ...]
    camera: CameraPlan
