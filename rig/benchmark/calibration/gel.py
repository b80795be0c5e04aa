"""Limits of the tactile colour map: radii of held-out balls that were pressed on a real sensor."""

import csv
from pathlib import Path

import numpy as np

from calibration.gel.balls import BallPress, calibrate_gel
from calibration.gel.presses import find_press
from drivers.images import read_image
from rig.benchmark.measured import Measured, at_most, informative, not_there

GELSIGHT_MINI_MM_PER_PX = (0.0634, 0.0634)
"""GelSight's own scale at 320 x 240; it nearly cancels in the radius of a ball."""


def gel_limits(data: Path | None) -> list[Measured]:
    """Fit the map to some presses and measure the radius in the others; each is left out once."""
    if data is None:
        return [not_there("tactile map: radius of held-out balls")]
    presses = gelsight_presses(data / "gelsight_ball")
    result = calibrate_gel(presses, GELSIGHT_MINI_MM_PER_PX)
    single = np.array([abs(result.held_out_mm[i] / true - 1.0) for i, true in result.true_mm.items()])
    rows = [
        at_most(
            f"tactile map: held-out balls of {2 * radius:.2f} mm, median radius off by, %",
            100 * abs(error),
            5.0,
        )
        for radius, error in result.radius_error().items()
    ]
    return [
        *rows,
        informative(
            f"tactile map: single held-out presses ({len(single)}), median off by, %", 100 * np.median(single)
        ),
        informative(
            "tactile map: single held-out presses, nine in ten within, %", 100 * np.percentile(single, 90)
        ),
        informative("tactile map: single held-out presses within 5 %, share", np.mean(single < 0.05)),
        at_most("tactile map: presses not found", 67 - len(presses), 0.0),
    ]


def gelsight_presses(folder: Path) -> list[BallPress]:
    """Return the presses in a folder with background.png and catalog.csv (image, diameter(mm))."""
    reference = read_image(folder / "background.png").astype(np.float32)
    presses = []
    with (folder / "catalog.csv").open(newline="") as stream:
        for row in csv.DictReader(stream):
            found = find_press(read_image(folder / row["image"]), reference, row["image"])
            if not isinstance(found, str):
                presses.append(BallPress(found, float(row["diameter(mm)"]) / 2.0))
    return presses
