"""A lab's own estimators, as a module in a separate folder."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from drivers.named_classes import _import_class

MODULE = "lab_rotation"
SOURCE = '''
"""Not the rig's."""
from dataclasses import replace
from pathlib import Path

import numpy as np

from rig.tactile.estimators import choose_estimator
from rig.tactile.sample import SlipSample, State, TactileEstimator

Path(__file__).with_name("imported").touch()


class Mine(TactileEstimator):
    """Returns the samples of `pca`, so that rows can be compared."""

    def __init__(self, background):
        self.inner = choose_estimator("pca", 1).make(background)

    def update(self, image, time_ns):
        return self.inner.update(image, time_ns)


class Arguments(TactileEstimator):
    """Reports the arguments of its constructor."""

    def __init__(self, background, *, aspect=None, sign=None):
        self.arguments = aspect, sign

    def update(self, image, time_ns):
        aspect, sign = self.arguments
        return SlipSample(time_ns, State.TRACKING, np.float32(aspect), np.int64(abs(sign)))


class Numpy(Mine):
    """Overwrites its frame, and returns NumPy scalars."""

    def update(self, image, time_ns):
        sample = super().update(image, time_ns)
        image[:] = 0
        angle = None if sample.angle_deg is None else np.float64(sample.angle_deg)
        return replace(sample, angle_deg=angle, contact_area_px=np.int64(sample.contact_area_px))


class Now_and_then(Mine):
    """Raises on every tenth frame."""

    count = 0

    def update(self, image, time_ns):
        self.count += 1
        if self.count % 10 == 0:
            raise ValueError("no gradient today")
        return super().update(image, time_ns)


class In_a_library(Mine):
    """Raises inside NumPy."""

    def update(self, image, time_ns):
        return self.angle(np.linalg.inv(np.zeros((2, 2))))


class Nan(Mine):
    """Computes NaN, of which NumPy warns."""

    def update(self, image, time_ns):
        angle_deg = float((np.zeros(1) / np.zeros(1))[0] + np.mean([]))
        return SlipSample(time_ns, State.TRACKING, angle_deg)


class Needs_more:
    def __init__(self, background, weights):
        pass

    def update(self, image, time_ns):
        pass


class No_update:
    def __init__(self, background):
        pass


function = len


class Rubbish:
    """Returns a different invalid value on each call."""

    answers = [
        None, 3.5, SlipSample(-1, State.LOST), {"state": "lost"}, "angle nan", "angle text", "angle true",
        "state", "sigma", "shift", "area", "area nan", "far too large", "no contact with an angle",
        "stage", "skipped",
    ]

    def __init__(self, background):
        self.left = list(self.answers)

    def update(self, image, time_ns):
        what = self.left.pop(0)
        good = SlipSample(time_ns, State.TRACKING, 1.0, contact_area_px=9.0)
        changed = {
            "angle nan": {"angle_deg": float("nan")},
            "angle text": {"angle_deg": "12"},
            "angle true": {"angle_deg": True},
            "state": {"state": "tracking it"},
            "sigma": {"sigma_deg": -1.0},
            "shift": {"shift_px": (1.0,)},
            "area": {"contact_area_px": None},
            "area nan": {"contact_area_px": float("inf")},
            "far too large": {"contact_area_px": 1e9},
            "no contact with an angle": {"state": State.NO_CONTACT},
            "stage": {"stage_s": {"all": "long"}},
            "skipped": {"skipped": "all"},
        }
        return replace(good, **changed[what]) if isinstance(what, str) else what
'''


@contextmanager
def own_estimators(folder: Path) -> Iterator[Path]:
    """Write the module, offer `lab-pca` of it as an entry point, and be in that folder meanwhile.

    Yields the file that is there once the module was imported.
    """
    (folder / f"{MODULE}.py").write_text(SOURCE)
    about = folder / "lab_rotation-0.3.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: lab-rotation\nVersion: 0.3\n")
    (about / "entry_points.txt").write_text(
        f"[slip_rig.estimators]\nlab-pca = {MODULE}:Mine\nslip = {MODULE}:Mine\n"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.syspath_prepend(str(folder))
        yield folder / "imported"
    sys.modules.pop(MODULE, None)
    forget()


def forget() -> None:
    """Remove the module from Python's cache, so that the next use imports it again."""
    _import_class.cache_clear()
