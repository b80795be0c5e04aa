"""An hour of a contact at rest: how far the angle wanders, and whether memory grows."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from drivers.clock import NS_PER_S, to_ns
from fakes.studio.clips import Scene, resting_frames
from rig.tactile.slip.estimator import SlipEstimator

RATE_HZ = 60.0
FRAMES = 216_000
WARM_UP_S = 1.0
"""The angle counts from here on, its mean over the next second being its zero."""
CONTACT = "t1:0"
_STATM = Path("/proc/self/statm")
_PAGE_MB = 4096 / 2**20


@dataclass(frozen=True, slots=True)
class Endurance:
    """What an hour came to.

    wander_deg: largest distance of an angle from its zero. answered: share of frames. grown_mb:
    resident memory at the end over that after a tenth of the frames, None where the system does not tell.
    """

    frames: int
    wander_deg: float
    answered: float
    grown_mb: float | None


def measure_endurance(
    seed: int = 0, frames: int = FRAMES, progress: Callable[[int, int], None] = lambda *_: None
) -> Endurance:
    """Show `slip` a contact at rest under fresh noise and drifting light, skipping nothing."""
    background, stream = resting_frames(Scene(CONTACT, rate_hz=RATE_HZ, seed=seed))
    tracker = SlipEstimator(background, skip=False)
    angles, before = np.full(frames, np.nan), None
    for i, angle in enumerate(_angles(tracker, stream, frames)):
        angles[i] = np.nan if angle is None else angle
        if i == frames // 10:
            before = _resident_mb()
        if i % (frames // 100 or 1) == 0:
            progress(i, frames)
    after = _resident_mb()
    first = round(WARM_UP_S * RATE_HZ)
    told = angles[first:]
    zero = np.nanmean(told[: round(RATE_HZ)])
    return Endurance(
        frames=frames,
        wander_deg=float(np.nanmax(np.abs(told - zero))),
        answered=float(np.isfinite(told).mean()),
        grown_mb=None if before is None or after is None else after - before,
    )


def _angles(tracker: SlipEstimator, stream: Iterator[np.ndarray], frames: int) -> Iterator[float | None]:
    for i in range(frames):
        yield tracker.update(next(stream), to_ns(i / RATE_HZ) + NS_PER_S).angle_deg


def _resident_mb() -> float | None:
    if not _STATM.exists():
        return None
    return int(_STATM.read_text().split()[1]) * _PAGE_MB
