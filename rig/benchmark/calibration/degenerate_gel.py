"""Tactile pictures and presses that a calibration must not take at face value."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from calibration.gel.balls import BallPress, calibrate_gel
from calibration.gel.presses import find_press
from calibration.gel.reference import assess_reference, drift_since, make_reference
from calibration.gel.scale import fit_scale
from drivers.types import Image
from fakes.studio.calibration_scenes import MM_PER_PX, SimulatedGel
from rig.benchmark.calibration.degenerate import Case, CaseAnswer, answered, refused

Rng = np.random.Generator
_GEL = SimulatedGel(seed=7)


def cases() -> list[Case]:
    """All cases of tactile sensors and their presses."""
    group = "tactile sensor"
    changes: list[tuple[str, Callable[[Image, Rng], Any], tuple[str, ...]]] = [
        ("nothing touches", lambda p, r: _GEL.frame(r), ("no contact",)),
        ("one hot pixel", lambda p, r: _spot(_GEL.frame(r)), ("no contact",)),
        ("a line", _line, ("not round", "no contact")),
        ("touched all over", lambda p, r: _brighter(_GEL.frame(r)), ("not round", "no contact")),
        ("constant picture", lambda p, r: np.full_like(p, 90), ("alike",)),
        ("another size", lambda p, r: p[:100], ("differ in size",)),
        ("grey picture", lambda p, r: p[..., 0], ("RGB is needed",)),
        ("float picture", lambda p, r: p.astype(np.float32), ("RGB is needed",)),
    ]  # fmt: skip
    listed = [Case(group, name, partial(_pressed, change=change), why) for name, change, why in changes]
    return [
        *listed,
        Case(group, "an LED out", partial(_reference, gain=(0.05, 1.0, 1.0)), ("LED went out",)),
        Case(group, "LEDs dimmed by a fifth", partial(_reference, gain=(0.8, 0.8, 0.8)), ("light changed",)),
        Case(group, "LEDs saturated", partial(_reference, gain=(6.0, 6.0, 6.0)), ("saturated",)),
        Case(group, "reference with contact in it", _touched_reference, ("changed shape",)),
        Case(group, "reference of another unit", _other_unit, ("changed shape",)),
        Case(group, "reference taken while touching", _touched_midway, ("changed while",)),
        Case(group, "ball radius below its print", partial(_balls, radius_mm=0.4), ("wider than a ball",)),
        Case(group, "three presses", partial(_balls, count=3), ("8 are the least",)),
        Case(group, "scale from moves along one line", _line_scale, ("span both axes",)),
        Case(group, "scales of x and y apart", _two_scales, ()),
    ]


def _pressed(rng: Rng, change: Callable[[Image, Rng], Any]) -> CaseAnswer:
    found = find_press(change(_GEL.presses(1)[0].image, rng), _GEL.reference, "press")
    return refused(found) if isinstance(found, str) else answered(found.reach_px, 0.0)


def _spot(picture: Image) -> Image:
    picture[100, 100] = 255
    return picture


def _brighter(picture: Image) -> Image:
    return np.clip(picture.astype(int) + 60, 0, 255).astype(np.uint8)


def _line(_: Image, rng: Rng) -> Image:
    picture = _GEL.frame(rng).astype(int)
    picture[20:300, 118:124] += 80
    return np.clip(picture, 0, 255).astype(np.uint8)


def _still(rng: Rng, gel: SimulatedGel = _GEL) -> list[Image]:
    return [gel.frame(rng) for _ in range(10)]


def _reference(rng: Rng, gain: tuple[float, float, float]) -> CaseAnswer:
    frames = [np.clip(f * np.asarray(gain), 0, 255).astype(np.uint8) for f in _still(rng)]
    return _assessed(frames)


def _assessed(frames: list[Image]) -> CaseAnswer:
    reference = make_reference(frames)
    assessment = assess_reference(reference, drift_since(reference, _GEL.reference))
    return refused(*assessment.reasons) if assessment.reasons else answered(1.0, 0.0)


def _touched_reference(_: Rng) -> CaseAnswer:
    return _assessed([_GEL.presses(1)[0].image] * 10)


def _touched_midway(rng: Rng) -> CaseAnswer:
    return _assessed([*_still(rng)[:6], *[_GEL.presses(1)[0].image] * 6])


def _other_unit(rng: Rng) -> CaseAnswer:
    return _assessed(_still(rng, SimulatedGel(seed=8)))


def _balls(_: Rng, count: int = 10, radius_mm: float | None = None) -> CaseAnswer:
    presses = []
    for made in _GEL.presses(count):
        found = find_press(made.image, _GEL.reference, made.name)
        if not isinstance(found, str):
            presses.append(BallPress(found, radius_mm or made.radius_mm))
    return answered(calibrate_gel(presses, MM_PER_PX).normal_rms, 0.0)


def _line_scale(rng: Rng) -> CaseAnswer:
    moves = np.column_stack([np.linspace(-4, 4, 8), np.zeros(8)])
    return answered(float(fit_scale(moves, rng.normal(moves / 0.06, 0.3)).mm_per_px[0]), 0.0)


def _two_scales(rng: Rng) -> CaseAnswer:
    moves = rng.uniform(-5, 5, (12, 2))
    scale = fit_scale(moves, rng.normal(moves / (0.058, 0.064), 0.3))
    return answered(float(np.abs(scale.mm_per_px / (0.058, 0.064) - 1.0).max()), 0.02)
