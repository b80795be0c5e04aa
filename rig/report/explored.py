"""Data of one lift for the page's program: linked plots and a film. JavaScript in `rig/pages/explore.js`.

Times are in s from the start of phase B, angles in deg. A refused value is null. Colours are names of the
page's palette.
"""

import io
import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from functools import cache, partial
from itertools import cycle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import PIL.Image
from jinja2.utils import htmlsafe_json_dumps

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.experiments.process_pool import run_in_order
from rig.pages.page import data_uri
from rig.pages.palette import ESTIMATE, FIRST, INK, SECOND, TRUTH, Colour
from rig.report.charts import SIGMAS, angle_range, shown_range
from rig.report.parts import anchor
from rig.report.session import UNREADABLE, Trial
from rig.report.strips import pictures, stored_images
from rig.results.metrics import Floats
from rig.sessions.manifest import TrialManifest
from rig.sessions.reading import recorded_gripper, recorded_joints
from rig.sessions.recorder import GRIPPER_TOPIC, JOINTS_TOPIC
from rig.sessions.recording_file import recorded_messages
from rig.sessions.records import Lift

FRAMES_BEFORE, FRAMES_OF_LIFT, FILM_HEIGHT_PX = 4, 20, 144
"""Number of images of a film in phase A, in which nothing turns, and from phase B on; height of an image."""
_STEPS = ((1, 35), (1, 12), (2, 12), (4, 8))
"""Steps of reduction: every nth image, and WebP quality. The first one that fits is used, else the last."""
_SAMPLED_EVERY = 6
"""Every nth image is encoded alone first, to leave out steps of reduction that will not fit."""
_ANGLE_PX, _SMALL_PX = 230, 90
MOST_BYTES, LEAST_FILM_BYTES = 5_900_000, 6_000
"""Size limit of a page, and least size reserved for a film, even if the page then exceeds its limit."""

Json = dict[str, Any]


def explorer_data(lift: Lift, panels: Sequence[Json], film: str | None = None) -> Json:
    """Return the data of a lift for the page's program, as JSON values."""
    start, end = shown_range(lift)
    onsets = ((TRUTH, lift.onset_truth_s), (ESTIMATE, lift.onset_estimate_s))
    return {
        "range": [round(start, 3), round(end, 3)],
        "phases": sorted(lift.begins_s.items(), key=lambda phase: phase[1]),
        "marks": [(colour.name, time_s) for colour, time_s in onsets if time_s is not None],
        "panels": panels,
        "film": film,
    }


def _panel(
    label: str, series: Sequence[Json], height_px: int = _SMALL_PX, limits: tuple[float, float] | None = None
) -> Json:
    """Return a plot over time. label: of its vertical axis. limits: of that axis, None to fit the values."""
    return {"label": label, "height": height_px, "limits": limits, "series": series}


def _series(
    lift: Lift,
    label: str,
    colour: Colour,
    time_s: Floats,
    *columns: Floats,
    dash: tuple[int, int] | None = None,
    width_px: int = 2,
) -> Json:
    """Return a curve in the shown range of a lift. columns: (N,) values and, if any, half a band's width.

    dash: px drawn and skipped.
    """
    start, end = shown_range(lift)
    inside = (time_s >= start) & (time_s <= end)
    table = [_numbers(time_s[inside], 3), *(_numbers(column[inside], 2) for column in columns)]
    return {"label": label, "colour": colour.name, "dash": dash, "width": width_px, "table": table}


def angle_panels(lift: Lift) -> list[Json]:
    """Return panels with the angles of markers, estimate (with band) and fingertips, and with the error."""
    estimate, truth = lift.estimate, lift.truth
    half = [SIGMAS * estimate.sigma_deg] if np.isfinite(estimate.sigma_deg).any() else []
    angles = [
        _series(lift, serial, colour, tip.time_s, tip.angle_deg, width_px=1)
        for (serial, tip), colour in zip(lift.tips.items(), cycle((FIRST, SECOND)), strict=False)
        if tip is not estimate
    ]
    if truth.time_s.size:
        angles.append(_series(lift, "markers", TRUTH, truth.time_s, truth.angle_deg, dash=(6, 4)))
    angles.append(_series(lift, "estimate", ESTIMATE, estimate.time_s, estimate.angle_deg, *half))
    panels = [_panel("angle, °", angles, _ANGLE_PX, angle_range(lift))]
    if truth.time_s.size:
        error = _series(lift, "estimate - markers", INK, estimate.time_s, lift.error_deg)
        panels.append(_panel("error, °", [error]))
    return panels


def pair_panels(names: tuple[str, str], first: Lift, second: Lift) -> list[Json]:
    """Return panels with the angles and errors of one lift on both sides of a comparison."""
    angles = [_series(first, "markers", TRUTH, first.truth.time_s, first.truth.angle_deg, dash=(6, 4))]
    errors = []
    for name, colour, lift in zip(names, (FIRST, SECOND), (first, second), strict=True):
        angles.append(_series(first, name, colour, lift.estimate.time_s, lift.estimate.angle_deg))
        errors.append(_series(first, name, colour, lift.estimate.time_s, lift.error_deg))
    return [_panel("angle, °", angles, _ANGLE_PX), _panel("error, °", errors)]


def recorded_lift(path: Path, lift: Lift, film: str | None = None) -> Json:
    """Return the data of a recorded lift, with the wrench and the grip.

    film: placeholder for the film's data. Gaps of the
    recording are skipped. Raises `SessionError` and other errors of `UNREADABLE`.
    """
    forces, openings = [], []
    for topic, time_ns, _, data in recorded_messages(path, JOINTS_TOPIC, GRIPPER_TOPIC, gaps=[]):
        time_s = (time_ns - lift.zero_ns) / NS_PER_S
        if topic == GRIPPER_TOPIC:
            openings.append((time_s, 1e3 * recorded_gripper(data, path).opening_m))
        elif (wrench := recorded_joints(data, path).wrench) is not None:
            forces.append((time_s, *wrench[:3]))
    panels = angle_panels(lift)
    if forces:  # at the hand, in the base's axes
        times, x, y, z = np.array(forces, float).T
        upward = _series(lift, "upward force", FIRST, times, z)
        sideways = _series(lift, "sideways force", SECOND, times, np.hypot(x, y))
        panels.append(_panel("force, N", [upward, sideways]))
    if openings:
        times, opening = np.array(openings, float).T
        panels.append(_panel("grip, mm", [_series(lift, "gripper's opening", INK, times, opening)]))
    return explorer_data(lift, panels, film)


def lift_film(path: Path, lift: Lift, manifest: TrialManifest, most_bytes: int) -> Json:
    """Return a film as one WebP sheet, a row per picture: fingertips and camera side by side.

    most_bytes: largest size of the sheet. To reach it, quality and number of images are reduced, down to the
    last of `_STEPS`. Raises `SessionError` and other errors of `UNREADABLE`.
    """
    start, end = shown_range(lift)
    before = np.linspace(start, 0.0, FRAMES_BEFORE, endpoint=False)
    times = np.concatenate([before, np.linspace(0.0, end, FRAMES_OF_LIFT)])
    stored, signs = stored_images(path, manifest.serials), manifest.signs
    sources = [
        pictures(path, stored, lift, serial, signs.get(serial), FILM_HEIGHT_PX) for serial in manifest.serials
    ]

    @cache
    def row(number: int) -> Image:
        shown = (picture_at(times[number])[0] for picture_at in sources)
        return np.concatenate([_at_height(picture, FILM_HEIGHT_PX) for picture in shown], axis=1)

    @cache
    def row_bytes(quality: int) -> float:
        sample = range(0, len(times), _SAMPLED_EVERY)
        return len(_webp(map(row, sample), quality)) / len(sample)

    sheet, every = b"", 1
    for every, quality in _STEPS:
        rows = range(0, len(times), every)
        if row_bytes(quality) * len(rows) <= most_bytes or (every, quality) == _STEPS[-1]:
            sheet = _webp(map(row, rows), quality)
            if len(sheet) <= most_bytes:
                break
    shown = times[::every]
    return {
        "sheet": data_uri(sheet),
        "times": _numbers(shown, 3),
        "size": [row(0).shape[1], FILM_HEIGHT_PX],
        "label": ", ".join(manifest.serials),
        "about": "" if every == 1 else f"{len(shown)} of {len(times)} pictures, to keep this page small",
    }


def _at_height(picture: Image, height_px: int) -> Image:
    height, width = picture.shape[:2]
    size = round(width * height_px / height), height_px
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def _webp(rows: Iterable[Image], quality: int) -> bytes:
    """Encode the rows of a sheet below one another."""
    encoded = io.BytesIO()
    # OpenCV has no choice of the method: its own takes twice as long for files 5 % smaller.
    PIL.Image.fromarray(np.concatenate(list(rows))).save(encoded, "WEBP", quality=quality, method=2)
    return encoded.getvalue()


def _numbers(values: Floats, digits: int) -> list[float | None]:
    return [round(v, digits) if np.isfinite(v) else None for v in values.tolist()]


def film_mark(lift: Lift) -> str:
    return f"film of {anchor(lift)}"


def with_films(page: str, trial: Trial, jobs: int = 1) -> str:
    """Return a trial's page with films in place of the placeholders, as large as the size limit allows.

    They are made last, in `jobs` processes, so that page and films together stay below the limit.
    """
    marks = {f'"film":"{film_mark(lift)}"': lift for lift in trial.lifts}
    marks = {mark: lift for mark, lift in marks.items() if mark in page}
    room = (MOST_BYTES - len(page.encode())) // max(len(marks), 1)
    most_bytes = max(room * 3 // 4, LEAST_FILM_BYTES)  # base64 adds a third
    made = run_in_order(partial(_film, trial.folder, trial.manifest, most_bytes), list(marks.values()), jobs)
    films = {mark: htmlsafe_json_dumps(film) for mark, film in zip(marks, made, strict=True)}
    # in one pass, so that a placeholder inside a film's data is not replaced
    pattern = "|".join(map(re.escape, films)) or "(?!)"
    return re.sub(pattern, lambda found: f'"film":{films[found.group()]}', page)


def _film(folder: Path, manifest: TrialManifest, most_bytes: int, lift: Lift) -> Json | None:
    with suppress(*UNREADABLE):  # the page has a notice about the damaged recording
        if lift.angles:
            return lift_film(folder / lift.recording, lift, manifest, most_bytes)
    return None
