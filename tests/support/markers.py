"""Search for all markers in a whole image, which no part of the product does."""

import numpy as np
from numpy.typing import NDArray

from calibration.targets.aruco import Refusal, detect_all, detector, refine_corners


def find_markers(gray: NDArray[np.uint8], dictionary: str) -> dict[int, NDArray[np.floating]]:
    """Search a whole (H, W) uint8 picture: refined (4, 2) px corners of every id seen exactly once."""
    single = {i: quads[0] for i, quads in detect_all(detector(dictionary), gray).items() if len(quads) == 1}
    refined = {i: refine_corners(gray, quad[None]) for i, quad in single.items()}
    return {i: corners[0] for i, corners in refined.items() if not isinstance(corners, Refusal)}
