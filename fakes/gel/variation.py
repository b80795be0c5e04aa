"""How far a simulated sensor unit departs from the family: for training sets that have to carry over.

A bench's units differ as units of one make do (`GelSensor`). Whoever trains on simulated frames wants
units that differ more than real ones might: domain randomisation (Tobin et al. 2017). Ranges are
wide on purpose and set by judgement; none was fitted to a real unit.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, slots=True)
class Variation:
    """What makes one unit unlike another; the defaults are the family's own values.

    slope_at_knee: slope (mm/mm) at which a colour's brightening begins to saturate.
    near_skirt_px, far_skirt_px: reach of the gel's membrane round a contact, in pixels of the
    geometry; near_share, far_share: how much of the depth it keeps there. flatten_mm: depth beyond
    which a contact's middle becomes flat, 0 for never. rim_per_mm, shadow_per_mm: light lost at the
    foot of a dent, and right behind it. streak_per_mm: light lost in long streaks behind a contact,
    0 for none. noise: factor on the read-out noise. light_seed: draws colours, directions and
    background anew, None for those of the unit. make_seed: draws the light of another make, None for a
    DIGIT's. film_px: of the geometry, over which the gel's film smooths relief. marks_seed: draws specks
    and scratches of the gel, None for a clean one.
    """

    slope_at_knee: float = 0.24
    near_skirt_px: int = 7
    near_share: float = 0.55
    far_skirt_px: int = 19
    far_share: float = 0.38
    flatten_mm: float = 0.0
    rim_per_mm: float = 3.0
    shadow_per_mm: float = 0.55
    streak_per_mm: float = 0.0
    noise: float = 1.0
    light_seed: int | None = None
    make_seed: int | None = None
    film_px: int = 5
    marks_seed: int | None = None


FAMILY = Variation()
"""The units of a bench."""


def draw_variation(rng: np.random.Generator) -> Variation:
    """Draw a unit that may be unlike every other."""
    return Variation(
        slope_at_knee=float(np.exp(rng.uniform(np.log(0.10), np.log(0.6)))),
        near_skirt_px=int(rng.integers(2, 7)) * 2 + 1,
        near_share=float(rng.uniform(0.3, 0.8)),
        far_skirt_px=int(rng.integers(6, 16)) * 2 + 1,
        far_share=float(rng.uniform(0.1, 0.5)),
        flatten_mm=float(rng.choice([0.0, rng.uniform(0.12, 0.6)])),
        rim_per_mm=float(rng.uniform(0.0, 5.0)),
        shadow_per_mm=float(rng.uniform(0.0, 1.2)),
        streak_per_mm=float(rng.choice([0.0, rng.uniform(0.2, 1.6)])),
        noise=float(rng.uniform(0.4, 2.0)),
        light_seed=int(rng.integers(1 << 31)),
    )
