"""Simulated tactile clips with a known angle. Estimators get only the images.

The contact rests, turns at a constant rate and rests again. The pivot is beside the contact's middle.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from drivers.clock import to_ns
from drivers.errors import InputError
from drivers.types import Image
from fakes.gel.pad import rotate
from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.catalogue import GraspSite, find_object
from fakes.objects.shapes import Ball, ContactShape, Pad
from fakes.objects.surfaces import Bulge, Surface, build_surface, depth_for_force

REST_S, AFTER_S = 0.4, 0.2
PIVOT_MM = (1.5, -2.0)
"""Pivot of the rotation, relative to the contact's middle."""
TILT = (0.008, -0.006)
FORCE_N = 0.8
TWO_BALLS = "two balls"
ROLLER = "roller"
"""A ribbed roller that rolls across the pad: its ribs turn by the scene's angle, its outline by more."""
_BALLS = Ball(radius_mm=7.0, x_mm=-3.4, z_mm=-1.0), Ball(radius_mm=5.0, x_mm=3.2, z_mm=1.2)
_FLAT = Pad(length_mm=60.0, width_mm=60.0)
_CONTACTS = {
    TWO_BALLS: ContactShape(_BALLS),
    ROLLER: ContactShape((_FLAT,), "ribs", texture_mm=0.12, pitch_mm=1.6, texture_deg=90.0, exact=True),
}
ROLLER_TURN_DEG, ROLLER_LEAN_DEG, _ROLLED_MM = 4.0, 13.5, 3.0
"""Rotation of a roller's ribs and of its outline; a real recording has below 5 and 12 to 15 degrees."""
_ROLLER_RADII_MM = (80.0, 9.0)


@dataclass(frozen=True, slots=True)
class Scene:
    """Content of a clip.

    contact: "OBJECT:SITE" of the simulated catalogue, such as "t1:0", or "two balls" or "roller". angle_deg:
    total rotation, counter-clockwise positive. center_mm: position of the contact on the gel, x right, y
    down. lag_deg: angle by which the gel around the contact trails behind. pressed: relative increase of the
    force during the rotation. unit: seed of the sensor. seed: of the specimen and the noise.
    """

    contact: str
    angle_deg: float = 30.0
    rate_deg_s: float = 40.0
    rate_hz: float = 60.0
    center_mm: tuple[float, float] = (0.0, 0.0)
    lag_deg: float = 0.0
    pressed: float = 0.0
    force_n: float = FORCE_N
    unit: int = 21
    seed: int = 0

    def force_at(self, share: float) -> float:
        """Return the force in N, to three digits, at a fraction of the rotation."""
        return round(self.force_n * (1.0 + self.pressed * share), 3)


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """Frames of one sensor, (N) of (H, W, 3) uint8 RGB, with times and true image angles (N,) deg.

    background: a frame without contact. moves_ns: start of the rotation. aspect: width over height of a pixel
    on the gel, as from a calibration; None if the estimator does not get it.
    """

    background: Image
    frames: tuple[Image, ...]
    time_ns: tuple[int, ...]
    angle_deg: NDArray[np.float64]
    moves_ns: int
    aspect: float | None


@lru_cache(maxsize=4)
def render_clip(scene: Scene) -> Clip:
    """Render a scene; the same scene gives the same clip. Raises `InputError` for an unknown contact."""
    sensor, surface = _sensor(scene.unit), _surface(scene.contact, scene.seed)
    across, down = sensor.mm_per_px
    rng = np.random.default_rng((scene.seed, scene.unit, 29))
    background = sensor.render(None, 0.0, rng)
    lasting_s = REST_S + abs(scene.angle_deg) / scene.rate_deg_s + AFTER_S
    times_s = np.arange(0.0, lasting_s, 1.0 / scene.rate_hz)
    shares = np.clip((times_s - REST_S) * scene.rate_deg_s / max(abs(scene.angle_deg), 1e-9), 0.0, 1.0)
    frames = tuple(
        sensor.render(_imprint(scene, surface, float(share)), float(t), rng)
        for t, share in zip(times_s, shares, strict=True)
    )
    times_ns = tuple(map(to_ns, times_s))
    return Clip(background, frames, times_ns, shares * scene.angle_deg, to_ns(REST_S), across / down)


def opposite(scene: Scene) -> Scene:
    return replace(scene, angle_deg=-scene.angle_deg)


def roller_imprint(scene: Scene, surface: Surface, share: float) -> Imprint:
    """Return the imprint of a ribbed roller, at a fraction `share` of its path.

    The outline is that of a bulge behind the ribs, which turns by a larger angle than the ribs.
    """
    lean_deg = math.copysign(ROLLER_LEAN_DEG, scene.angle_deg) * share
    body, rolled_mm = Bulge(_ROLLER_RADII_MM, lean_deg), _ROLLED_MM * (share - 0.5)
    (x_mm, y_mm), depth_mm = scene.center_mm, depth_for_force(surface, scene.force_at(share), bulge=body)
    return Imprint(
        surface, share * scene.angle_deg, (x_mm, y_mm + 2.0 * rolled_mm), depth_mm,
        bulge=body, bulge_mm=(x_mm, y_mm + rolled_mm),
    )  # fmt: skip


def _imprint(scene: Scene, surface: Surface, share: float) -> Imprint:
    if scene.contact == ROLLER:
        return roller_imprint(scene, surface, share)
    angle = share * scene.angle_deg
    x, y = rotate(*PIVOT_MM, math.radians(angle))
    center = scene.center_mm[0] + PIVOT_MM[0] - x, scene.center_mm[1] + PIVOT_MM[1] - y
    depth = depth_for_force(surface, scene.force_at(share), TILT, 0.0, scene.center_mm)
    lag = math.copysign(scene.lag_deg * (4.0 * share * (1.0 - share)), scene.angle_deg)
    return Imprint(surface, angle, center, depth, TILT, lag)


_sensor = lru_cache(maxsize=4)(GelSensor)


@lru_cache(maxsize=8)
def _surface(contact: str, seed: int) -> Surface:
    return build_surface(contact_shape(contact), 1, seed)


def contact_shape(contact: str) -> GraspSite | ContactShape:
    """Return the contact with a name as in `Scene`. Raises `InputError` for an unknown one."""
    if contact in _CONTACTS:
        return _CONTACTS[contact]
    name, _, number = contact.partition(":")
    sites = find_object(name).sites
    if not number.isdecimal() or int(number) >= len(sites):
        raise InputError(f"contact '{contact}': give OBJECT:SITE with a site from 0 to {len(sites) - 1}")
    return sites[int(number)]
