"""The angles of a lift over time, from its recording or from a plain table."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rig.tactile.angles import Angles, Floats


@dataclass(frozen=True, slots=True, eq=False)
class LiftCurves:
    """All curves of one lift; times in s from the start of phase B (in a table: as given), angles in deg.

    estimate: the fused angle. truth: the marker angle. tips: the angle of each fingertip, by serial.
    phases_s: start times of phases, "A", "B", "C" and "lower" among them; empty if unknown. onset_truth_s,
    onset_estimate_s: None without a slip. notes: damaged parts of the recording, which are left out, or
    wrapped angles of a table. axes: ranges of the chart's axes, s and deg, see
    `rig.report.lift_chart.on_one_scale`; None: from the curves.
    """

    name: str
    estimate: Angles
    truth: Angles
    phases_s: dict[str, float] = field(default_factory=dict)
    onset_truth_s: float | None = None
    onset_estimate_s: float | None = None
    tips: dict[str, Angles] = field(default_factory=dict)
    time_label: str = "time from the start of the lift, s"
    notes: tuple[str, ...] = ()
    axes: tuple[tuple[float, float], tuple[float, float]] | None = None

    @property
    def error_deg(self) -> Floats:
        """Estimate minus truth at each frame of the estimate, (N,) deg; NaN if either is missing."""
        return self.estimate.angle_deg - self.truth.at(self.estimate.time_s)

    def errors(self, *phases: str) -> Floats:
        """Return the known absolute errors in some phases, by default in all frames, (M,) deg."""
        errors = np.abs(self.error_deg[self.within(*phases)] if phases else self.error_deg)
        return errors[np.isfinite(errors)]

    def within(self, *phases: str) -> NDArray[np.bool_]:
        """Return which frames of the estimate, (N,) bool, are in these phases; all if phases are unknown."""
        times = self.estimate.time_s
        inside = np.zeros(times.shape, bool)
        for phase in phases:
            if phase in self.phases_s:
                begins = self.phases_s[phase]
                ends = min((t for t in self.phases_s.values() if t > begins), default=np.inf)
                inside |= (times >= begins) & (times < ends)
        return inside if self.phases_s else np.ones(times.shape, bool)
