"""Which motion both channels of a contact speak for: its slopes, and its fine texture.

The slopes of a contact (`rig.tactile.slip.registration`) hold nearly all of the energy and tell a turn to a
few hundredths of a degree where they turn with the object. Under a smooth or soft object they are the gel's
own bulge, which does not turn; what turns then is a line, an edge or a mark (`rig.tactile.slip.texture`).
Neither channel is right everywhere. They are therefore aligned together, each weighted by how well it fits
(the likelihood of a channel whose noise is unknown); and of several motions found that one is believed for
which both channels together say most. What fits as well where it was before says nothing of a motion and
counts little: it is gel, a speck or a scratch.
"""

import math
from dataclasses import dataclass

from rig.tactile.slip.keyframe import Keyframe
from rig.tactile.slip.loops import align_together, correlation_at, weights_of
from rig.tactile.slip.sampling import GradientField
from rig.tactile.slip.texture import TextureField, TextureKey

# A channel that leaves less of its energy than this unexplained says no more for it: the rest is no noise.
LEAST_UNEXPLAINED = 0.1
ITERATIONS, FEW_ITERATIONS = 8, 4
# So many points of a keyframe's slopes are enough here.
SLOPE_POINTS = 300


@dataclass(frozen=True, slots=True)
class Weighting:
    """How much each channel counts."""

    slopes: float
    texture: float


TOGETHER = Weighting(0.25, 1.0)
TEXTURE_FIRST, SLOPES_FIRST = Weighting(0.02, 1.0), Weighting(1.0, 0.05)


@dataclass(frozen=True, slots=True)
class Motion:
    """A motion since a keyframe and what speaks for it.

    angle_rad; shift_px of the keyframe's center. slopes, texture: correlation of each channel with its
    template, at most 1, what rests counted little.
    """

    angle_rad: float
    shift_px: complex
    slopes: float
    texture: float

    @property
    def evidence(self) -> float:
        """What both channels say for it: -log(1 - correlation^2) / 2 added up, per independent point."""
        unexplained = (1.0 - max(c, 0.0) ** 2 for c in (self.slopes, self.texture))
        return sum(-0.5 * math.log(max(share, LEAST_UNEXPLAINED)) for share in unexplained)


class Evidence:
    """One keyframe and one frame: finds motions and weighs them."""

    def __init__(self, key: Keyframe, texture: TextureKey, field: GradientField, seen: TextureField) -> None:
        slopes = key.within(field, -(-len(key.points_px) // SLOPE_POINTS))
        fine = texture.within(seen, key.center_px)
        self._slopes, self._fine = (slopes, weights_of(slopes)), (fine, weights_of(fine))

    def align(
        self, angle_rad: float, shift_px: complex, weighting: Weighting, iterations: int
    ) -> tuple[float, complex]:
        """Return the angle and shift found from a start."""
        shares = weighting.slopes, weighting.texture
        return align_together(*self._slopes, *self._fine, angle_rad, complex(shift_px), shares, iterations)

    def judged(self, angle_rad: float, shift_px: complex) -> Motion:
        """Return what speaks for a motion."""
        shift = complex(shift_px)
        slopes, fine = (correlation_at(*channel, angle_rad, shift) for channel in (self._slopes, self._fine))
        return Motion(angle_rad, shift_px, slopes, fine)
