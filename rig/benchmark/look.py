"""`rig benchmark look`: compare photographs of presses on a real unit with simulated images in its look."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.gel.look_fit import Circle, fit_look
from drivers.images import encode_png
from drivers.types import Image
from fakes.studio.calibration_scenes import draw_press
from rig.benchmark.harness import Report, Run, Study, Table, column, option, table_of
from rig.benchmark.measured import Measured, at_most, informative
from rig.calibrate.press_folder import read_press_folder

Array = NDArray[np.floating]

MOST_RATIO, MOST_CLASSIFIED = 0.5, 0.75
GENERIC_UNITS = 4
_AROUND = 1.7
"""A press is compared in a square of this multiple of its circle's radius to each side."""
_COLOURS, _CONTACT_NOISE, _NOISE = slice(0, 15), slice(15, 21), slice(21, None)
"""Slices of the statistics: of colours, of fine noise around the contact, and of fine noise beside it."""
_BESIDE = 2.2
"""Farther from the contact than this multiple of its circle's radius, the gel is untouched."""
_RIDGE = 1.0
"""Ridge parameter of the linear classifier, on standardised statistics."""


@dataclass(frozen=True, slots=True)
class LookOptions:
    """Options of `rig benchmark look`."""

    presses: Path = option(..., "Folder of photographs of pressed balls, as rig calibrate tactile reads it.")
    ball_mm: float | None = option(None, "Diameter of the ball, without catalog.csv.", min=2, max=30)
    background: Path | None = option(None, "The untouched gel. Default: background.png of the folder.")
    circles: Path | None = option(None, "CSV of circles drawn by hand. Default: circles.csv, if any.")
    mm_per_px: tuple[float, float] = option((0.06, 0.06), "Scale along x and y.")
    pictures: Path | None = option(None, "PNG of photographs (above) and held-out drawings (below).")


@dataclass(frozen=True, slots=True)
class PressRow:
    """A press that was left out of the fit, with the errors of its simulated image: a row of the table."""

    press: str = column("press left out")
    change_grey: float = column("colour change", ".1f", "rms of the photograph, grey levels")
    look_grey: float = column("error of the look", ".1f", "rms, grey levels")
    generic_grey: float = column("error of a generic look", ".1f", "rms over four made-up units, grey levels")


def measure(options: LookOptions, run: Run) -> Report:
    """Draw held-out presses of a real sensor in its own look; compare them with the photographs.

    Each press is left out of the fit once and rendered by the simulator from its circle. Its colour change is
    compared with that of the photograph; so are the colour changes of generic simulated units. Then a linear
    classifier, trained on the other presses only, classifies photographs and simulated images by simple
    statistics; 50 % correct is chance. The exit code is 4 if a limit is missed.

    Examples:
      rig benchmark look --presses presses --ball-mm 8.8 --mm-per-px 0.0535 0.0535

    """
    folder = read_press_folder(options.presses, options.ball_mm, options.background, options.circles)
    fit = fit_look(folder.pressed, folder.background, options.mm_per_px)
    rows, real, drawn, made_up, shown = [], [], [], [], []
    for number, (held_out, press) in enumerate(zip(fit.held_out, folder.pressed, strict=True)):
        look = fit.without(held_out)
        ours = draw_press(look, number, held_out.circle, press.radius_mm)
        generic = [draw_press(None, unit, press.circle, press.radius_mm) for unit in range(GENERIC_UNITS)]
        photograph = press.image.astype(np.float32) - look.background
        rows.append(
            PressRow(
                press.id,
                _rms(photograph, press.circle),
                _rms(photograph - ours.change, press.circle),
                float(np.sqrt(np.mean([_rms(photograph - g.change, press.circle) ** 2 for g in generic]))),
            )
        )
        real.append(statistics(press.image, press.circle))
        drawn.append(statistics(ours.image, press.circle))
        made_up.append(statistics(generic[number % GENERIC_UNITS].image, press.circle))
        shown.append(np.vstack([press.image, ours.image]))
        run.progress(number + 1, len(fit.held_out), press.id)
    if options.pictures is not None:
        options.pictures.write_bytes(encode_png(np.hstack(shown)))
    limits = judge(rows, *(np.array(each) for each in (real, drawn, made_up)))
    return Report(tables=(_table(rows),), limits=limits)


def judge(rows: Sequence[PressRow], real: Array, drawn: Array, made_up: Array) -> tuple[Measured, ...]:
    """Return the limits. real, drawn, made_up: (N, S) statistics of photographs, look and generic units."""
    ours, generic = (np.array([getattr(row, key) for row in rows]) for key in ("look_grey", "generic_grey"))
    ratio = float(np.sqrt((ours**2).mean() / (generic**2).mean()))
    return (
        at_most("colour error over that of a generic look", ratio, MOST_RATIO),
        at_most("share classified correctly by colours", classified(real, drawn, _COLOURS), MOST_CLASSIFIED),
        informative(
            "share classified correctly by noise beside the contact", classified(real, drawn, _NOISE)
        ),
        informative(
            "share classified correctly by noise in the contact", classified(real, drawn, _CONTACT_NOISE)
        ),
        informative(
            "a generic look: share classified correctly by colours", classified(real, made_up, _COLOURS)
        ),
    )


def statistics(image: Image, circle: Circle) -> Array:
    """Return statistics of an image (H, W, 3) of a press.

    They are level, standard deviation, range and gradient of each channel around the contact; and fine
    noise around the contact, and beside it.
    """
    x, y, radius = (round(value) for value in circle)
    reach = round(_AROUND * radius)
    around = slice(max(y - reach, 0), y + reach), slice(max(x - reach, 0), x + reach)
    smooth = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 2.0)
    fine, part = image - smooth, smooth[around]
    rows, columns = np.indices(image.shape[:2])
    beside = np.hypot(columns - circle[0], rows - circle[1]) > _BESIDE * circle[2]
    per_channel = [
        part.mean((0, 1)),
        part.std((0, 1)),
        *np.percentile(part, (5, 95), axis=(0, 1)),
        np.hypot(*np.gradient(part, axis=(0, 1))).mean((0, 1)),
        *_noise(fine[around], np.ones(part.shape[:2], bool)),
        *_noise(fine, beside),
    ]
    return np.concatenate(per_channel)


def _noise(fine: Array, where: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Standard deviation per channel, and correlation with the right neighbour."""
    variance = (fine[where] ** 2).mean(0)
    together = (fine[:, 1:] * fine[:, :-1])[where[:, 1:] & where[:, :-1]].mean(0)
    return np.sqrt(variance), together / variance


def classified(real: Array, drawn: Array, by: slice) -> float:
    """Return the fraction of images that a linear classifier classifies correctly, by leave-one-pair-out.

    real, drawn: (N, S) statistics, of which `by` are used.
    """
    real, drawn, right = real[:, by], drawn[:, by], []
    for i in range(len(real)):
        learnt = np.vstack([np.delete(real, i, 0), np.delete(drawn, i, 0)])
        sides = np.repeat([1.0, -1.0], len(real) - 1)
        middle, spread = learnt.mean(0), learnt.std(0) + 1e-9
        scaled = (learnt - middle) / spread
        weights = np.linalg.solve(scaled.T @ scaled + _RIDGE * np.eye(scaled.shape[1]), scaled.T @ sides)
        right += [
            ((real[i] - middle) / spread) @ weights > 0.0,
            ((drawn[i] - middle) / spread) @ weights < 0.0,
        ]
    return float(np.mean(right))


def _rms(change: Array, circle: Circle) -> float:
    """Return the rms of a difference image (H, W, 3) around a press, at half resolution to reduce noise."""
    half = cv2.resize(change.astype(np.float32), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    rows, columns = np.indices(half.shape[:2]) * 2 + 0.5
    near = np.hypot(columns - circle[0], rows - circle[1]) < _AROUND * circle[2]
    return float(np.sqrt((half[near] ** 2).mean()))


def _table(rows: Sequence[PressRow]) -> Table:
    return table_of(
        "Presses left out, drawn from their circles: rms colour error, grey levels", PressRow, rows
    )


STUDY = Study(name="look", options=LookOptions, measure=measure, cases="presses", shared=(), simulated=True)
