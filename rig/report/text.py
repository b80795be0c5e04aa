"""Formatting of numbers, the same on every page."""

import math
from datetime import datetime

from rig.results.metrics import Mare


def mare_tile(value: Mare | None, what: str) -> tuple[str, str]:
    """Return the tile of a MARE: the figure, and below it a description with interval and refused lifts."""
    return mare_short(value), f"{what} {value.beside if value else ''}".rstrip()


def mare_short(value: Mare | None) -> str:
    """Return MARE and standard deviation, deg."""
    return "no answer" if value is None else f"{value.mean_deg:.2f} ± {value.std_deg:.2f}°"


def made_text(when: datetime) -> str:
    """Return the creation time of a page. when: in UTC."""
    return when.strftime("%Y-%m-%d %H:%M UTC")


def angle_text(angle_deg: float | None) -> str:
    """Return an angle with its sign."""
    if angle_deg is None or not math.isfinite(angle_deg):
        return "refused"
    return f"{round(angle_deg, 1) + 0.0:+.1f}°"
