"""The reported angle with its rate, sigma and shift, over all contacts of a sensor."""

import math
from dataclasses import replace

from drivers.clock import NS_PER_S
from drivers.types import Image
from rig.tactile.sample import SlipSample, State
from rig.tactile.slip.outline import Outline
from rig.tactile.slip.parameters import ALIGNMENT, MOST_RATE_RAD_S, MOTION, SIGMA
from rig.tactile.slip.tracker import Contact, Tracked

ANY_TURN_RAD = math.pi / math.sqrt(12.0)
"""Largest standard deviation: all angles within a half turn to either side are equally likely."""
MOST_LOSS = 3.0
"""A loss counts at most so much: 1 is that of an error of 10 degrees, and beyond 30 degrees most contacts
agree no more. With 1, 5 of 45 hard SIMULATED lifts are confidently wrong, with 3 none."""


class Report:
    """Turns the fits of the tracker into samples.

    px_per_work: pixels of the frame per work pixel, along x and y. angle_rad: the last answer; None before
    the first.
    """

    def __init__(self, px_per_work: tuple[float, float]) -> None:
        self._px_per_work = px_per_work
        self._fitted_ns = 0
        self._settled, self._outline = False, Outline()
        self.begin()

    def begin(self) -> None:
        """Forget all contacts."""
        self._outline.forget()
        self.angle_rad: float | None = None
        self._variance = self._unseen = self._rate_rad_s = 0.0
        self._origin_px: complex | None = None

    def gives_up(self, time_ns: int) -> bool:
        """Whether no keyframe has fitted for `give_up_s`."""
        return (time_ns - self._fitted_ns) / NS_PER_S > ALIGNMENT.give_up_s

    def release(self, time_ns: int) -> None:
        """Note that a contact has ended. The rotation until the next one is not observed."""
        if self.angle_rad is not None:
            elapsed_s = (time_ns - self._fitted_ns) / NS_PER_S
            # The object may have stopped or continued, and accelerated.
            speed = abs(self._rate_rad_s) + 0.5 * MOTION.acceleration_rad_s2 * elapsed_s
            self._unseen = self._variance + min(speed * elapsed_s, ANY_TURN_RAD) ** 2
        self._rate_rad_s = 0.0
        self._outline.forget()

    def gripped_further(self) -> None:
        """Note that the present contact has changed its shape without a rotation."""
        self._outline.forget()

    def answer(
        self, sample: SlipSample, tracked: Tracked, contact: Contact | None, mask: Image
    ) -> SlipSample:
        """Return the sample with the angle, its rate and sigma.

        contact: None in its first frame. mask: (h, w) uint8, 1 inside the contact region.
        """
        last, wanted, variance = self.angle_rad, tracked.fit.angle_rad, _variance(tracked)
        if sample.settled is True:
            wanted, variance = self._outline.correct(wanted, variance, mask)
        elapsed_s = (sample.time_ns - self._fitted_ns) / NS_PER_S
        most = MOST_RATE_RAD_S * elapsed_s
        angle = wanted if last is None else min(max(wanted, last - most), last + most)
        # While the angle follows at its limit, it is no zero.
        self._settled = sample.settled is True and (self._settled or angle == wanted)
        variance += (wanted - angle) ** 2 + self._unseen
        if last is not None:
            slowly = variance + math.exp(-elapsed_s / SIGMA.pace_s) * (self._variance - variance)
            variance = max(variance, self._variance) if tracked.rekeyed else slowly
        self.angle_rad, self._variance, self._fitted_ns = angle, variance, sample.time_ns
        self._rate_rad_s = tracked.rate_rad_s
        return replace(
            sample,
            state=State.REKEYED if tracked.rekeyed and last is not None else State.TRACKING,
            angle_deg=math.degrees(angle),
            sigma_deg=math.degrees(math.sqrt(variance)),
            unseen_deg=math.degrees(math.sqrt(min(self._unseen, variance))),
            rate_deg_s=math.degrees(self._rate_rad_s),
            settled=self._settled,
            shift_px=self._shift_px(tracked, contact),
        )

    def _shift_px(self, tracked: Tracked, contact: Contact | None) -> tuple[float, float]:
        """Return the shift since the tracked point is known: since the frame after the first one."""
        point = tracked.fit.pose.point_px - (0j if contact is None else contact.anchored_px)
        if self._origin_px is None and contact is not None:
            self._origin_px = point
        shift = 0j if self._origin_px is None else point - self._origin_px
        return shift.real * self._px_per_work[0], shift.imag * self._px_per_work[1]


def _variance(tracked: Tracked) -> float:
    """Return the variance of the rotation since the contact began, as far as it was seen, rad^2."""
    return (
        SIGMA.least_rad**2
        + (SIGMA.worst_loss_rad * min(tracked.worst_loss, MOST_LOSS)) ** 2
        + (SIGMA.worst_spread * tracked.worst_spread_rad) ** 2
    )


def extrapolate(last: SlipSample, time_ns: int) -> SlipSample:
    """Return the sample of a frame that repeats the last one, at the angle that its rate predicts."""
    if last.angle_deg is None:
        return replace(last, time_ns=time_ns)
    ahead_s = min((time_ns - last.time_ns) / NS_PER_S, MOTION.horizon_s)
    angle_deg = last.angle_deg + (last.rate_deg_s or 0.0) * ahead_s
    sigma_deg = math.hypot(last.sigma_deg or 0.0, angle_deg - last.angle_deg)
    return replace(last, time_ns=time_ns, angle_deg=angle_deg, sigma_deg=sigma_deg)
