"""Whether the markers look as far away as the camera was found to stand: a wrong size or place shows here.

How large a marker of known side appears gives its distance, and so does where the camera stands. The
angle itself needs neither, so without this check a wrong number would go unseen.
"""

from dataclasses import dataclass

from rig.sessions.records import MarkerDistance

MOST_OFF = 0.10
"""Share of the distance that is still no warning: an object's thickness, markers off its middle."""


@dataclass(frozen=True, slots=True)
class ExpectedDistance:
    """What is known beforehand: the markers' side, and the distance by the camera's place, both m."""

    marker_side_m: float
    placed_m: float

    def warning(self, distance_sides: float | None) -> MarkerDistance | None:
        """Compare with a distance in marker sides; None within 10 %, or where it is unknown."""
        if distance_sides is None:
            return None
        seen_m = distance_sides * self.marker_side_m
        off = abs(seen_m - self.placed_m) > MOST_OFF * self.placed_m
        return MarkerDistance(seen_m, self.placed_m) if off else None
