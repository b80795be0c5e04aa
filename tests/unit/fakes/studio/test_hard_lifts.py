"""Simulated lifts: hard ones turn by the true angle, easy ones are those of earlier versions."""

import cv2
import numpy as np
import pytest

from drivers.clock import to_ns
from fakes.clock import SimulatedClock
from fakes.devices.digit import DigitPlan, FakeDigit
from fakes.faults import FaultScript
from fakes.gel.pad import GelPad, Imprint
from fakes.gel.variation import Variation
from fakes.objects.surfaces import KINDS, Bulge, soft_surface
from fakes.studio.conditions import Difficulty, draw_conditions
from fakes.world.mirror import MirroredWorld, snapshot_of
from support.worlds import lifting_world

LINES = ("lines", "edge", "corner")
"""Kinds of soft faces of which little more than a line or two turns."""
SHAPE, MM_PER_PX = (320, 240), (0.06, 0.06)
BULGE = Bulge((60.0, 30.0), 25.0)
PAD = GelPad(SHAPE, MM_PER_PX, variation=Variation(film_px=3))
TIMES_S = (0.1, 0.4, 0.9, 1.6, 2.4)
STORED_SUMS = {
    ("SIM-D0001", 1, "t1"): [5921, 49527, 167357, 77341],
    ("SIM-D0002", -1, "t5"): [6592, 36880, 127886, 62278],
}
"""`signed_sums` of frames drawn before there were hard lifts."""
MOST_ROUNDED = 200
"""Grey values, of 1,152,000, that another processor may round to the next one. Code of NumPy, OpenCV and
OpenBLAS for processors without AVX rounds 11."""


def digit(name: str, serial: str, side: int, difficulty: Difficulty = "easy", seed: int = 1) -> FakeDigit:
    plan = DigitPlan(serial, side, 60.0, 0, difficulty=difficulty)
    return plan.make(lifting_world(name, seed), SimulatedClock(), FaultScript())


def frames(source: FakeDigit) -> list[np.ndarray]:
    return [source.draw(to_ns(t), np.random.default_rng(to_ns(t))) for t in TIMES_S]


def soft_seed() -> int:
    return next(seed for seed in range(50) if draw_conditions("hard", seed, 1).kind in LINES)


def relief(kind: str, angle_deg: float) -> np.ndarray:
    """Return the dent by the face in addition to that of its bulge, mm."""
    surface = soft_surface(kind, 1, 4)
    flat = soft_surface(kind, 1, 4)
    flat.height_mm[:] = np.median(surface.height_mm[112:144, 112:144])
    return dent(surface, angle_deg) - dent(flat, angle_deg)


def dent(surface, angle_deg: float) -> np.ndarray:
    return PAD.dent(Imprint(surface, angle_deg, depth_mm=0.5, bulge=BULGE))


def turned(field: np.ndarray, angle_deg: float) -> np.ndarray:
    rows, columns = field.shape
    middle = ((columns - 1) / 2, (rows - 1) / 2)
    return cv2.warpAffine(field, cv2.getRotationMatrix2D(middle, angle_deg, 1.0), (columns, rows))


def signed_sums(images: list[np.ndarray]) -> list[int]:
    """Return four sums of all grey values with random signs.

    A grey value that changes by 1 changes each sum by 1, but other noise in all of them by thousands.
    """
    values = np.array(images, np.int64).ravel()
    return [int(values @ np.random.default_rng(n).choice([-1, 1], values.size)) for n in range(4)]


@pytest.mark.parametrize("unit", STORED_SUMS)
def test_frames_of_easy_lifts_have_the_stored_sums(unit: tuple[str, int, str]) -> None:
    serial, side, name = unit
    sums = signed_sums(frames(digit(name, serial, side)))
    assert sums == pytest.approx(STORED_SUMS[unit], abs=MOST_ROUNDED)


def test_hard_lift_is_determined_by_its_seed() -> None:
    seed = soft_seed()
    one, again, other = (
        frames(digit("t1", "SIM-D0001", 1, "hard", number)) for number in (seed, seed, seed + 1)
    )
    np.testing.assert_array_equal(one, again)
    assert np.abs(np.subtract(one, other, dtype=int)).mean() > 2


@pytest.mark.parametrize("kind", KINDS)
def test_relief_turns_by_the_angle_of_the_object(kind: str) -> None:
    middle = np.hypot(*np.mgrid[-79.5:80, -59.5:60]) < 22
    still, moved = relief(kind, 10.0), relief(kind, 35.0)
    likeness = {
        off: np.corrcoef(turned(still, 25.0 + off)[middle], moved[middle])[0, 1] for off in (-6, -3, 0, 3, 6)
    }
    assert max(likeness, key=likeness.__getitem__) == 0
    assert likeness[0] > 0.9


def test_mirrored_world_shows_the_same_hard_lift() -> None:
    world = lifting_world("t1", soft_seed())
    mirror = MirroredWorld(world.layout, snapshot_of(world, 0))
    plan = DigitPlan("SIM-D0001", 1, 60.0, 0, difficulty="hard")
    here, there = (plan.make(seen, SimulatedClock(), FaultScript()) for seen in (world, mirror))
    for time_s in TIMES_S:
        mirror.feed(snapshot_of(world, to_ns(time_s)))
        one, other = (each.draw(to_ns(time_s), np.random.default_rng(0)) for each in (here, there))
        np.testing.assert_array_equal(one, other)
