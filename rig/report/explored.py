"""Data of one lift for the page's program: linked plots and a film. JavaScript in `rig/pages/explore.js`.

Times are in s from the start of phase B, angles in deg. A refused value is null. Colours are names of the
page's palette.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jinja2.utils import htmlsafe_json_dumps

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.pages.page import data_uri
from rig.pages.palette import ESTIMATE, FIRST, INK, SECOND, TRUTH, Colour
from rig.report.curves import signed_errors
from rig.report.lift_chart import SIGMAS, angle_range, shown_range
from rig.report.parts import anchor
from rig.report.session import UNREADABLE, Trial
from rig.report.strips import pictures
from rig.results.metrics import Floats
from rig.sessions.lift_curves import LiftCurves
from rig.sessions.manifest import TrialManifest
from rig.sessions.reading import recorded_gripper, recorded_joints
from rig.sessions.recorder import GRIPPER_TOPIC, JOINTS_TOPIC
from rig.sessions.recording_file import recorded_messages
from rig.sessions.records import Lift

FRAMES_BEFORE, FRAMES_OF_LIFT, FILM_HEIGHT_PX = 4, 20, 144
"""Number of images of a film in phase A, in which nothing turns, and from phase B on; height of an image."""
_STEPS = ((1, 35), (1, 12), (2, 12), (4, 8))
"""Steps of reduction: every nth image, and WebP quality. The first one that fits is used, else the last."""
_ANGLE_PX, _SMALL_PX = 230, 90

Messages = list[tuple[int, bytes]]
"""Time in ns by the bench's clock, and data."""


@dataclass(frozen=True, slots=True)
class Series:
    """Values over time, (N,) each. half: half the width of a band around them. dash: px drawn and skipped."""

    label: str
    colour: Colour
    time_s: Floats
    values: Floats
    half: Floats | None = None
    dash: tuple[int, int] | None = None
    width_px: int = 2


@dataclass(frozen=True, slots=True)
class Panel:
    """A plot over the time of a lift.

    label: of its vertical axis, with the unit. limits: of that axis, None to fit the values.
    """

    label: str
    series: Sequence[Series]
    height_px: int = _SMALL_PX
    limits: tuple[float, float] | None = None


def explored(lift: LiftCurves, panels: Sequence[Panel], film: str | None = None) -> dict[str, Any]:
    """Return the data of a lift for the page's program, as JSON values."""
    start, end = shown_range(lift)
    panels_shown = [
        {
            "label": panel.label,
            "height": panel.height_px,
            "limits": panel.limits,
            "series": [_shown(one, start, end) for one in panel.series],
        }
        for panel in panels
    ]
    onsets = ((TRUTH, lift.onset_truth_s), (ESTIMATE, lift.onset_estimate_s))
    return {
        "range": [round(start, 3), round(end, 3)],
        "phases": sorted(lift.phases_s.items(), key=lambda phase: phase[1]),
        "marks": [(colour.name, time_s) for colour, time_s in onsets if time_s is not None],
        "panels": panels_shown,
        "film": film,
    }


def _shown(one: Series, start_s: float, end_s: float) -> dict[str, Any]:
    inside = (one.time_s >= start_s) & (one.time_s <= end_s)
    shown = {"label": one.label, "colour": one.colour.name, "dash": one.dash, "width": one.width_px}
    columns = (one.values,) if one.half is None else (one.values, one.half)
    return {**shown, "table": [_numbers(one.time_s[inside], 3), *(_numbers(c[inside], 2) for c in columns)]}


def angle_panels(lift: LiftCurves) -> list[Panel]:
    """Return panels with the angles of markers, estimate (with band) and fingertips, and with the error."""
    estimate = lift.estimate
    half = SIGMAS * estimate.sigma_deg if np.isfinite(estimate.sigma_deg).any() else None
    colours = zip(lift.tips.items(), cycle((FIRST, SECOND)), strict=False)
    angles = [
        Series(serial, colour, tip.time_s, tip.angle_deg, width_px=1)
        for (serial, tip), colour in colours
        if tip is not estimate
    ]
    if lift.truth.time_s.size:
        angles.append(Series("markers", TRUTH, lift.truth.time_s, lift.truth.angle_deg, dash=(6, 4)))
    angles.append(Series("estimate", ESTIMATE, estimate.time_s, estimate.angle_deg, half))
    panels = [Panel("angle, °", angles, _ANGLE_PX, angle_range(lift))]
    if lift.truth.time_s.size:
        error = Series("estimate - markers", INK, estimate.time_s, signed_errors(lift))
        panels.append(Panel("error, °", [error]))
    return panels


def pair_panels(names: tuple[str, str], first: LiftCurves, second: LiftCurves) -> list[Panel]:
    """Return panels with the angles and errors of one lift on both sides of a comparison."""
    sides = list(zip(names, (FIRST, SECOND), (first, second), strict=True))
    angles = [
        Series(name, colour, lift.estimate.time_s, lift.estimate.angle_deg) for name, colour, lift in sides
    ]
    errors = [Series(name, colour, lift.estimate.time_s, signed_errors(lift)) for name, colour, lift in sides]
    truth = Series("markers", TRUTH, first.truth.time_s, first.truth.angle_deg, dash=(6, 4))
    return [Panel("angle, °", [truth, *angles], _ANGLE_PX), Panel("error, °", errors)]


def recorded_lift(path: Path, lift: LiftCurves, zero_ns: int, film: str | None = None) -> dict[str, Any]:
    """Return the data of a recorded lift, with the wrench and the grip.

    zero_ns: start of phase B by the recording's clock. film: placeholder for the film's data. Gaps of the
    recording are skipped. Raises `SessionError` and other errors of `UNREADABLE`.
    """
    messages: dict[str, Messages] = {JOINTS_TOPIC: [], GRIPPER_TOPIC: []}
    for topic, time_ns, _, data in recorded_messages(path, *messages, gaps=[]):
        messages[topic].append((time_ns, data))
    panels = angle_panels(lift)
    panels += _wrench(messages[JOINTS_TOPIC], path, zero_ns) + _grip(messages[GRIPPER_TOPIC], path, zero_ns)
    return explored(lift, panels, film)


def _wrench(messages: Messages, path: Path, zero_ns: int) -> list[Panel]:
    """Force at the hand in the base's axes."""
    known = [
        (time_ns, joints.wrench)
        for time_ns, data in messages
        if (joints := recorded_joints(data, path)).wrench is not None
    ]
    if not known:
        return []
    times = _seconds([time_ns for time_ns, _ in known], zero_ns)
    forces = np.array([wrench[:3] for _, wrench in known], float)
    upward = Series("upward force", FIRST, times, forces[:, 2])
    sideways = Series("sideways force", SECOND, times, np.hypot(forces[:, 0], forces[:, 1]))
    return [Panel("force, N", [upward, sideways])]


def _grip(messages: Messages, path: Path, zero_ns: int) -> list[Panel]:
    states = [recorded_gripper(data, path) for _, data in messages]
    if not states:
        return []
    times = _seconds([time_ns for time_ns, _ in messages], zero_ns)
    opening = np.array([state.opening_m for state in states], float) * 1e3
    return [Panel("grip, mm", [Series("gripper's opening", INK, times, opening)])]


def lift_film(
    path: Path, lift: LiftCurves, zero_ns: int, manifest: TrialManifest, most_bytes: int
) -> dict[str, object]:
    """Return a film as one WebP sheet, a row per picture: fingertips and camera side by side.

    most_bytes: largest size of the sheet. To reach it, quality and number of images are reduced, down to the
    last of `_STEPS`. Raises `SessionError` and other errors of `UNREADABLE`.
    """
    start, end = shown_range(lift)
    before = np.linspace(start, 0.0, FRAMES_BEFORE, endpoint=False)
    times = np.concatenate([before, np.linspace(0.0, end, FRAMES_OF_LIFT)])
    columns = []
    for serial in manifest.serials:
        found = pictures(path, lift, zero_ns, serial, manifest.signs.get(serial), times.tolist())
        columns.append(np.array([_small(picture) for picture, _ in found]))
    rows, data, every = np.concatenate(columns, axis=2), b"", 1
    for every, quality in _STEPS:
        data = _webp(np.concatenate(rows[::every]), quality)
        if len(data) <= most_bytes:
            break
    shown = times[::every]
    return {
        "sheet": data_uri(data),
        "times": _numbers(shown, 3),
        "size": [rows.shape[2], FILM_HEIGHT_PX],
        "label": ", ".join(manifest.serials),
        "about": "" if every == 1 else f"{len(shown)} of {len(times)} pictures, to keep this page small",
    }


def _small(picture: Image) -> Image:
    width = round(picture.shape[1] * FILM_HEIGHT_PX / picture.shape[0])
    return np.asarray(cv2.resize(picture, (width, FILM_HEIGHT_PX), interpolation=cv2.INTER_AREA), np.uint8)


def _webp(sheet: Image, quality: int) -> bytes:
    bgr = cv2.cvtColor(sheet, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".webp", bgr, [cv2.IMWRITE_WEBP_QUALITY, quality])[1].tobytes()


def _seconds(times_ns: Sequence[int], zero_ns: int) -> Floats:
    return (np.array(times_ns, np.int64) - zero_ns) / NS_PER_S


def _numbers(values: Floats, digits: int) -> list[float | None]:
    return [round(v, digits) if np.isfinite(v) else None for v in values.tolist()]


MOST_BYTES, LEAST_FILM_BYTES = 5_900_000, 6_000
"""Size limit of a page, and least size reserved for a film, even if the page then exceeds its limit."""


def film_mark(lift: Lift) -> str:
    """Return the placeholder of a lift's film in the page's data."""
    return f"film of {anchor(lift)}"


def with_films(page: str, trial: Trial) -> str:
    """Return a trial's page with films in place of the placeholders, as large as the size limit allows."""
    marks = {f'"film":"{film_mark(lift)}"': lift for lift in trial.lifts}
    marks = {mark: lift for mark, lift in marks.items() if mark in page}
    room = (MOST_BYTES - len(page.encode())) // max(len(marks), 1)
    most_bytes = max(room * 3 // 4, LEAST_FILM_BYTES)  # base64 adds a third
    films = {mark: htmlsafe_json_dumps(_film_of(trial, lift, most_bytes)) for mark, lift in marks.items()}
    # in one pass, so that a placeholder inside a film's data is not replaced
    pattern = "|".join(map(re.escape, films)) or "(?!)"
    return re.sub(pattern, lambda found: f'"film":{films[found.group()]}', page)


def _film_of(trial: Trial, lift: Lift, most_bytes: int) -> dict[str, object] | None:
    if lift.curves is None:
        return None
    path = trial.folder / lift.recording
    try:
        return lift_film(path, lift.curves, lift.zero_ns, trial.manifest, most_bytes)
    except UNREADABLE:  # the page has a notice about the damaged recording
        return None
