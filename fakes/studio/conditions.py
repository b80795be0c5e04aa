"""Conditions of a hard lift, drawn from its seed: face, growth of the contact, gel, light and codec.

Their frequencies follow real recordings of a GelSight Mini: a third of them show a line or two on a broad
bulge, a fifth a peel that rolls, some show sheets with creases, and the rest various stiff objects.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np

from fakes.gel.variation import FAMILY, Codec, Variation, draw_codec
from fakes.objects.shapes import ContactShape
from fakes.objects.surfaces import KINDS, Bulge, draw_bulge

Difficulty = Literal["easy", "hard"]

FACE_SHARES = {"lines": 0.26, "edge": 0.24, "corner": 0.08, "skin": 0.12, "creases": 0.08}
"""Fractions of hard lifts with a soft face, by kind; the others have the object's normal surface."""
GROWTH_OVER_DEG = 20.0
_GROWING, _SOFT_GROWING, _OTHER_MAKE, _MARKED, _CODED = 0.6, 0.8, 0.7, 0.8, 0.6
_CODED_HZ = (30.0, 25.0, 15.0, 10.0)
_ROLL_MM_PER_RAD = {"skin": 5.0, "creases": 3.0}
_ROCK_MM_PER_RAD = 3.0


@dataclass(frozen=True, slots=True)
class Conditions:
    """Conditions of one lift at one fingertip.

    kind: kind of the soft face, None for the object's normal surface. bulge: the bulge behind a soft face.
    press: factor on the fingers' force. growth: relative increase of the force over `GROWTH_OVER_DEG` of
    rotation. roll_mm_per_rad, rock_mm_per_rad: motion of the face and of the bulge per rotation of the
    object, in image axes of the camera's side. unit: the gel and its light. codec: of the images, None for
    none. rate_hz: highest frame rate if the sensor chooses the rate, None for the requested rate.
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
        """Return the factor on the force after a rotation."""
        return self.press * (1.0 + self.growth * min(abs(turn_deg) / GROWTH_OVER_DEG, 1.0))

    def face(self, contact: ContactShape) -> tuple[str | None, Bulge | None]:
        """Return the kind of soft face that replaces a contact's surface, and its bulge.

        None for both if the object has exact sizes, or is smooth and round.
        """
        soft = not (contact.exact or contact.smooth_round)
        return (self.kind, self.bulge) if soft else (None, None)


EASY = Conditions()


@lru_cache(maxsize=16)
def draw_conditions(difficulty: Difficulty, seed: int, side: int) -> Conditions:
    """Draw the conditions of a lift at the fingertip of a side (+1 or -1); `EASY` for easy lifts."""
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
    """Draw a kind of soft face with the given frequencies; None for the remaining cases."""
    drawn = float(rng.random())
    for kind in KINDS:
        drawn -= shares[kind]
        if drawn < 0.0:
            return kind
    return None


def draw_unit(make: int | None, marks: int | None, rng: np.random.Generator) -> Variation:
    """Draw a soft gel. make, marks: seeds of another make's light and of specks, None for none."""
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
