"""Compare the measured distance of the markers with the expected one, to detect a wrong size or camera pose.

The apparent size of a marker of known side gives its distance, and so does the pose of the camera. The angle
itself depends on neither, so without this check a wrong value would go undetected.
"""

from dataclasses import dataclass

from rig.sessions.records import MarkerDistance

MOST_OFF = 0.10
"""Largest relative difference without a warning: objects have a thickness, markers are not at their
centre."""


@dataclass(frozen=True, slots=True)
class ExpectedDistance:
    """Expected values: side of the markers, and their distance from the pose of the camera, both in m."""

    marker_side_m: float
    placed_m: float

    def warning(self, distance_sides: float | None) -> MarkerDistance | None:
        """Compare with a distance in marker sides; None within 10 %, or if it is unknown."""
        if distance_sides is None:
            return None
        seen_m = distance_sides * self.marker_side_m
        off = abs(seen_m - self.placed_m) > MOST_OFF * self.placed_m
        return MarkerDistance(seen_m, self.placed_m) if off else None
