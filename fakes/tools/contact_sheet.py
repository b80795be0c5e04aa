"""Writes simulated frames beside real ones: `python -m fakes.tools.contact_sheet OUT.png`.

Real frames are read from the folder named by RIG_TEST_DATA, where there is one. For looking at,
not for measuring.
"""

import os
import sys
from pathlib import Path

import cv2
import numpy as np

from drivers.errors import RigError
from drivers.types import Image
from fakes.gel.sensor import GelSensor, Imprint
from fakes.objects.catalogue import load_catalogue
from fakes.objects.surfaces import build_surface, depth_for_force

_COLUMNS = 12
_DEFAULT_DATA = "../shared/data"
_REAL = (
    "aurova_figures/digit_raw.png",
    "aurova_figures/limitation_raw_digit.png",
    *(f"aurova_figures/panels/{n}_raw.png" for n in range(1, 10)),
    "digit_backgrounds/tacto_bg_digit_240_320.jpg",
)


def main(arguments: list[str]) -> int:
    """Write the sheet to the given file; return the exit code."""
    if len(arguments) != 1:
        print("usage: python -m fakes.tools.contact_sheet OUT.png", file=sys.stderr)
        return 2
    frames = [*_real_frames(), *_units(), *_sites()]
    frames += [np.zeros_like(frames[0])] * (-len(frames) % _COLUMNS)
    rows = [np.hstack(frames[i : i + _COLUMNS]) for i in range(0, len(frames), _COLUMNS)]
    if not cv2.imwrite(arguments[0], cv2.cvtColor(np.vstack(rows), cv2.COLOR_RGB2BGR)):
        raise RigError(f"cannot write {arguments[0]}")
    return 0


def _real_frames() -> list[Image]:
    folder = Path(os.environ.get("RIG_TEST_DATA", _DEFAULT_DATA))
    read = [
        cv2.imread(str(folder / name), cv2.IMREAD_COLOR_RGB) for name in _REAL if (folder / name).exists()
    ]
    return [np.asarray(cv2.resize(image, (240, 320)), np.uint8) for image in read if image is not None]


def _units() -> list[Image]:
    return [GelSensor(unit).render(None, 0.0, np.random.default_rng(unit)) for unit in range(_COLUMNS)]


def _sites() -> list[Image]:
    """Every grasp site of the catalogue on one unit, at varied angles and forces."""
    rng = np.random.default_rng(1)
    sensor = GelSensor(1)
    frames = []
    for model in load_catalogue().values():
        for site in model.sites:
            surface = build_surface(site, int(rng.choice([-1, 1])), 3)
            tilt = (float(rng.normal(0.0, 0.015)), float(rng.normal(0.0, 0.015)))
            imprint = Imprint(
                surface=surface,
                angle_deg=float(rng.uniform(-35.0, 35.0)),
                centre_mm=(float(rng.normal(0.0, 0.8)), float(rng.normal(0.0, 1.0))),
                depth_mm=depth_for_force(surface, float(rng.uniform(0.4, 1.6)), tilt),
                tilt=tilt,
            )
            frames.append(sensor.render(imprint, 0.0, rng))
    return frames


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
