"""What an estimator says about one tactile frame."""

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol

from drivers.types import ArmState, Image


class State(StrEnum):
    """What the estimator can claim about a frame (contract: names are fixed)."""

    NO_CONTACT = "no_contact"
    TRACKING = "tracking"
    REKEYED = "rekeyed"
    UNOBSERVABLE = "unobservable"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class SlipSample:
    """The answer for one frame, at the frame's own time.

    angle_deg: image angle, counter-clockwise positive as seen (theta = -atan2(dy, dx)),
    unwrapped over time, None where the estimator refuses. Its zero is the estimator's own: only
    differences mean anything. sigma_deg: one standard deviation, None where the method has
    none. unseen_deg: the part of it that comes from turns while the contact was lost.
    rate_deg_s, shift_px (x right, y down, since the reference): None where unknown.
    contact_area_px: contact area in pixels of the given image, 0 without contact.
    stage_s: wall time spent per stage; skipped: names of the stages that were not needed.
    """

    time_ns: int
    state: State
    angle_deg: float | None = None
    sigma_deg: float | None = None
    unseen_deg: float = 0.0
    rate_deg_s: float | None = None
    shift_px: tuple[float, float] | None = None
    contact_area_px: float = 0.0
    stage_s: dict[str, float] = field(default_factory=dict)
    skipped: tuple[str, ...] = ()

    def sigma_since(self, zero: "SlipSample | None") -> float | None:
        """Return one standard deviation of the turn between a zero and this, deg; None as sigma_deg.

        What was not seen before both of them does not count, what was not seen in between does.
        """
        if self.sigma_deg is None or zero is None:
            return self.sigma_deg
        seen = self.sigma_deg**2 - self.unseen_deg**2
        return math.sqrt(max(seen, 0.0) + abs(self.unseen_deg**2 - zero.unseen_deg**2))


class SlipEstimator(Protocol):
    """Turns the frames of one tactile sensor into slip samples, one call per frame."""

    def update(self, image: Image, time_ns: int) -> SlipSample:
        """Estimate from (H, W, 3) uint8 RGB captured at `time_ns`; causal, never raises on content."""
        ...

    def arm(self, state: ArmState) -> None:
        """Take the arm's state, sampled before the next frames; most estimators look at frames alone."""
