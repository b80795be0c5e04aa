"""What a hard lift is like: its face, how it grows, its gel, light and codec, all drawn from the lift's seed.

Shares follow what real recordings of a GelSight Mini hold: a third of them a line or two on a broad bulge, a
fifth a peel that rolls, some sheets with creases, the rest stiff things of all kinds.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from fakes.gel.variation import FAMILY, Codec, Variation, draw_codec
from fakes.objects.relief import KINDS, Bulge, draw_bulge
from fakes.objects.shapes import ContactShape

Difficulty = Literal["easy", "hard"]

FACE_SHARES = {"lines": 0.26, "edge": 0.24, "corner": 0.08, "skin": 0.12, "creases": 0.08}
"""Share of the hard lifts whose face is soft, by kind; the others show the object's own."""
GROWTH_OVER_DEG = 20.0
_GROWING, _SOFT_GROWING, _OTHER_MAKE, _MARKED, _CODED = 0.6, 0.8, 0.7, 0.8, 0.6
_CODED_HZ = (30.0, 25.0, 15.0, 10.0)
_ROLL_MM_PER_RAD = {"skin": 5.0, "creases": 3.0}
_ROCK_MM_PER_RAD = 3.0


@dataclass(frozen=True, slots=True)
class Conditions:
    """What one lift is like to a fingertip.

    kind: of its soft face, None for the object's own; bulge: behind it. press: how much harder than the
    fingers' force says; growth: share by which it grows over `GROWTH_OVER_DEG` of turn. roll_mm_per_rad:
    how the face moves as it turns, rock_mm_per_rad: how the bulge does, as the thing tilts; both in image
    axes of the camera's side. unit: the gel and its light. codec: of its pictures, None for none; rate_hz:
    at most so many of them a second where the sensor is free to choose, None for as many as it is asked.
    """

    kind: str | None = None
    bulge: Bulge | None = None
    press: float = 1.0
    growth: float = 0.0
    roll_mm_per_rad: tuple[float, float] = (0.0, 0.0)
    rock_mm_per_rad: tuple[float, float] = (0.0, 0.0)
    unit: Variation = FAMILY
    codec: Codec | None = None
    rate_hz: float | None = None

    def pressed_more(self, turn_deg: float) -> float:
        """Return how many times as hard the press is at a turn."""
        return self.press * (1.0 + self.growth * min(abs(turn_deg) / GROWTH_OVER_DEG, 1.0))

    def face(self, contact: ContactShape) -> tuple[str | None, Bulge | None]:
        """Return the soft face in place of a contact's own, and its bulge.

        None for both on what is made to size, or smooth and round.
        """
        soft = not (contact.exact or contact.smooth_round)
        return (self.kind, self.bulge) if soft else (None, None)


EASY = Conditions()


@lru_cache(maxsize=16)
def draw_conditions(difficulty: Difficulty, seed: int, side: int) -> Conditions:
    """Draw what the lift of a seed is like to the fingertip of a side (+1 or -1); `EASY` where all is."""
    if difficulty == "easy":
        return EASY
    both, own = np.random.default_rng((seed, 61)), np.random.default_rng((seed, 67, side + 1))
    kind = draw_kind(FACE_SHARES, both)
    growing = _SOFT_GROWING if kind else _GROWING
    growth = float(both.uniform(0.3, 1.5)) if both.random() < growing else 0.0
    roll = both.normal(0.0, _ROLL_MM_PER_RAD.get(kind, 1.5), 2) if kind else np.zeros(2)
    rock = both.normal(0.0, _ROCK_MM_PER_RAD, 2) if kind else np.zeros(2)
    make = int(own.integers(1 << 31)) if both.random() < _OTHER_MAKE else None
    worn = both.random() < _MARKED
    coded = both.random() < _CODED
    rate_hz = float(both.choice(_CODED_HZ))
    press = float(both.uniform(1.0, 2.5)) if kind else 1.0
    return Conditions(
        kind=kind,
        bulge=draw_bulge(kind, own) if kind else None,
        press=press,
        growth=growth,
        roll_mm_per_rad=(float(roll[0]), float(roll[1])),
        rock_mm_per_rad=(float(rock[0]), float(rock[1])),
        unit=draw_unit(make, int(own.integers(1 << 31)) if worn else None, own),
        codec=draw_codec(own) if coded else None,
        rate_hz=rate_hz if coded else None,
    )


def draw_kind(shares: Mapping[str, float], rng: np.random.Generator) -> str | None:
    """Draw a kind of soft face by the kinds' shares of all faces; None for the others."""
    drawn = float(rng.random())
    for kind in KINDS:
        drawn -= shares[kind]
        if drawn < 0.0:
            return kind
    return None


def draw_unit(make: int | None, marks: int | None, rng: np.random.Generator) -> Variation:
    """Draw a soft gel. make, marks: seeds of another make's light and of specks; None for neither."""
    return replace(
        FAMILY,
        slope_at_knee=float(np.exp(rng.uniform(np.log(0.2), np.log(0.45)))),
        film_px=3,
        flatten_mm=float(rng.choice([0.0, rng.uniform(0.3, 0.8)])),
        rim_per_mm=float(rng.uniform(0.5, 3.5)),
        shadow_per_mm=float(rng.uniform(0.1, 0.7)),
        noise=float(rng.uniform(0.5, 1.3)),
        make_seed=make,
        marks_seed=marks,
    )
