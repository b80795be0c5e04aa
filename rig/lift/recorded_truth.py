"""Read the true angle of a lift from its recording."""

from pathlib import Path

import numpy as np

from rig.lift.marker_truth import TruthSeries
from rig.sessions.reading import recorded_angles
from rig.sessions.recorder import TRUTH_TOPIC


def recorded_truth(recording: Path) -> TruthSeries:
    """Read the markers' angle of a recorded lift; the reasons of refused frames are not recorded.

    Raises `SessionError`.
    """
    angles = recorded_angles(recording, TRUTH_TOPIC)[TRUTH_TOPIC]
    return TruthSeries(
        np.array([angle.time_ns for angle in angles], np.int64),
        np.array([angle.angle_deg for angle in angles], float),
        np.array([angle.sigma_deg for angle in angles], float),
        0.0,
        None,
        {},
    )
