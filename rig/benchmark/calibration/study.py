"""`rig benchmark calibration`: the limits of the calibrations, measured with fixed seeds."""

from dataclasses import dataclass
from typing import Annotated

import cv2
import typer

from rig.benchmark.calibration.angle_scenes import AngleRow, angle_rows
from rig.benchmark.calibration.bad_data import BadDataRow, bad_data_rows
from rig.benchmark.calibration.limits import camera_limits, gel_limits, hand_eye_limits, sync_limits
from rig.benchmark.calibration.markers import marker_limits
from rig.benchmark.harness import Report, Run, Study, table_of
from rig.benchmark.measured import at_most, data_folder


@dataclass(frozen=True, slots=True)
class CalibrationOptions:
    """Options of `rig benchmark calibration`."""

    trials: Annotated[int, typer.Option("--trials", min=20, help="Hand-eye trials.")] = 200


def measure(options: CalibrationOptions, run: Run) -> Report:
    """Measure the calibrations against their limits, on simulated and, where they are, real data.

    Exit code 4 when a limit is missed, or bad data went through without being refused.

    Examples:
      rig benchmark calibration

      rig benchmark calibration --trials 50 --json

    """
    cv2.setNumThreads(1)
    seed, data = run.seed, data_folder()
    run.say("measuring: ways to the two-marker angle")
    angles = angle_rows(seed)
    parts = {
        "two-marker angle": lambda: marker_limits(seed, data, angles),
        "hand-eye": lambda: hand_eye_limits(seed, options.trials),
        "intrinsics": lambda: camera_limits(seed, data),
        "time offset": lambda: sync_limits(seed),
        "tactile map": lambda: gel_limits(data),
    }
    # one after the other: some of them measure time
    limits = [row for rows in run.each(lambda part: parts[part](), list(parts), workers=1) for row in rows]
    run.say("measuring: bad data")
    bad = bad_data_rows(seed)
    refused, right, wrong = (sum(getattr(row, kind) for row in bad) for kind in ("refused", "right", "wrong"))
    title = "rms error, worst, deg (mean at rest); answered unless all; ms of processor time per picture"
    return Report(
        tables=(
            table_of(title, AngleRow, angles, left=4),
            table_of("Refused with the right reason, or right", BadDataRow, bad, left=6),
        ),
        limits=(*limits, at_most("bad data: wrong answers and wrong refusals", wrong, 0)),
        limits_of="the calibrations: simulated data unless 'real' or 'photos'",
        notes=(f"{len(bad)} cases: {refused} refused, {right} right, {wrong} wrong",),
    )


STUDY = Study(
    name="calibration",
    options=CalibrationOptions,
    measure=measure,
    cases="calibrations",
    shared=("out", "seed"),
)
