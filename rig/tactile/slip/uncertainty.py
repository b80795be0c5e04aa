"""Standard deviation of an angle: noise and model errors.

Noise is the smaller part, because thousands of pixels are averaged. Model errors remain: the gel yields at
the edge of the contact, colours saturate, and the map was learnt from one image. Such errors grow with the
misfit of the alignment and decrease with the contrast. Their sigma is therefore proportional to the misfit
over the root of the contrast. The factor was fitted on objects outside all benchmarks: the simulated ones
that no trial uses (seed 1000, 42 lifts). With 5, 6.5 and 8 degrees 87, 90 and 91 % of the errors are within
two sigma; the smallest factor with at least 90 % was selected. The other errors are of another kind: 70 % of
them are in three bent contacts, with errors of 5 to 15 % of the rotation; in the rest an object jerks between
two frames of the markers.

A dent whose outline leans while its object does not turn, as of a roller, also looks like a rotation. The
difference to the rotation that is found if the curvature may change, too, is a further sigma.
"""

import math

from rig.tactile.slip.registration import Alignment

SYSTEMATIC_RAD = math.radians(6.5)
FLOOR_RAD = math.radians(0.03)
# Relative standard deviation of the pixel aspect (width over height on the gel), unknown and calibrated.
# After a rotation by d, the angle of a long contact has an error of up to a sin(d) for an aspect error of a.
ASPECT_UNKNOWN, ASPECT_KNOWN = 0.02, 0.003


def angle_variance(alignment: Alignment, contrast: float, aspect_known: bool) -> float:
    """Return the variance of an alignment's angle, rad^2, without that of its keyframe."""
    systematic = SYSTEMATIC_RAD * alignment.misfit / math.sqrt(contrast)
    aspect = (ASPECT_KNOWN if aspect_known else ASPECT_UNKNOWN) * math.sin(alignment.angle_rad)
    errors = FLOOR_RAD, alignment.noise_rad, systematic, aspect, alignment.bent_rad
    return sum(error**2 for error in errors)
