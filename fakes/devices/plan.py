"""Description of a simulated bench that can be sent to another process; creation of its sensors."""

import hashlib
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from drivers.clock import Clock
from drivers.types import Pose
from fakes.camera.marker_scene import MarkerScene
from fakes.devices.camera import FakeCamera, Shutter
from fakes.devices.digit import FakeDigit
from fakes.faults import FaultScript
from fakes.gel.look import Look
from fakes.gel.variation import FAMILY, draw_variation
from fakes.studio.conditions import Difficulty, draw_conditions
from fakes.world.fixture import PrintedSheet, nothing_printed
from fakes.world.mirror import WorldView
from fakes.world.state import BenchLayout

CAMERA_MISALIGNMENT = Rotation.from_euler("xyz", (0.8, -0.6, 0.4), degrees=True)
"""Rotation from the camera's pose in the bench file to its true pose; a real bench has such an error too."""

_scene = cache(MarkerScene)
"""Cached, because a scene takes as long as a hundred frames and is the same on every bench."""


@dataclass(frozen=True, slots=True)
class DigitPlan:
    """Description of a fingertip.

    side: +1 if it looks in the direction of the camera, else -1. number: index from 0, which sets the phase
    of its frames. variation_seed: seed of a sensor with random properties; None for a typical sensor.
    markers: whether dots are printed on its gel. difficulty: of its lifts. look: of a real sensor, None for a
    made-up light.
    """

    serial: str
    side: int
    rate_hz: float
    number: int
    variation_seed: int | None = None
    markers: bool = False
    difficulty: Difficulty = "easy"
    look: Look | None = None

    def slowed(self, seed: int) -> "DigitPlan":
        """Return the fingertip with its frame rate in the lift of a seed; some video codecs reduce it."""
        given_hz = draw_conditions(self.difficulty, seed, self.side).rate_hz
        return self if given_hz is None else replace(self, rate_hz=min(given_hz, self.rate_hz))

    def make(self, world: WorldView, clock: Clock, faults: FaultScript) -> FakeDigit:
        """Make the sensor. Its individual properties depend on the serial only, not on the bench."""
        shutter = Shutter(self.rate_hz, phase_s=0.002 + 0.005 * self.number)
        seed, unit = self.variation_seed, unit_seed(self.serial)
        if seed is not None:
            unit = unit_seed(f"{self.serial}/{seed}")
        variation = FAMILY if seed is None else draw_variation(np.random.default_rng((seed, self.number)))
        return FakeDigit(
            world,
            clock,
            faults,
            self.serial,
            unit,
            self.side,
            shutter,
            variation,
            self.markers,
            self.difficulty,
            self.look,
        )


@dataclass(frozen=True, slots=True)
class CameraPlan:
    """Description of the external camera.

    base_T_camera: its pose in the bench file. printed: prints the sheets of calibration targets.
    """

    serial: str
    rate_hz: float
    size_px: tuple[int, int]
    focal_px: float
    marker_ids: tuple[int, int]
    marker_side_m: float
    marker_dictionary: str
    base_T_camera: Pose  # noqa: N815
    printed: PrintedSheet = nothing_printed

    def make(self, world: WorldView, clock: Clock, faults: FaultScript) -> FakeCamera:
        """Make the camera with its true pose, which differs from the bench file's by about 1 degree."""
        nominal = self.base_T_camera
        true_pose = Pose.from_rotation(nominal.position_m, nominal.rotation * CAMERA_MISALIGNMENT)
        shutter = Shutter(self.rate_hz, phase_s=0.009, latency_s=0.006)
        scene = _scene(
            size=self.size_px,
            focal_px=self.focal_px,
            marker_ids=self.marker_ids,
            marker_side_m=self.marker_side_m,
            dictionary=self.marker_dictionary,
            unit_seed=unit_seed(self.serial),
        )
        return FakeCamera(world, clock, faults, self.serial, shutter, scene, true_pose, self.printed)


@dataclass(frozen=True, slots=True)
class BenchPlan:
    """Description of a simulated bench."""

    layout: BenchLayout
    digits: tuple[DigitPlan, ...]
    camera: CameraPlan


def unit_seed(serial: str) -> int:
    """Return the seed of the individual properties of a device."""
    return int.from_bytes(hashlib.sha256(serial.encode()).digest()[:4], "big")
