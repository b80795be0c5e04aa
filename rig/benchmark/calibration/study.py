"""`rig benchmark calibration`: the limits of the calibrations, measured with fixed seeds."""

from dataclasses import dataclass
from typing import Annotated

import cv2
import typer

from rig.benchmark.calibration import (
    degenerate_gel,
    degenerate_hand_eye,
    degenerate_images,
    degenerate_streams,
    degenerate_views,
)
from rig.benchmark.calibration.angle_scenes import AngleRow, angle_rows
from rig.benchmark.calibration.camera import camera_limits
from rig.benchmark.calibration.degenerate import run_cases
from rig.benchmark.calibration.gel import gel_limits
from rig.benchmark.calibration.hand_eye import hand_eye_limits, sync_limits
from rig.benchmark.calibration.markers import marker_limits
from rig.benchmark.harness import Report, Run, Study, column, table_of
from rig.benchmark.measured import at_most, data_folder


@dataclass(frozen=True, slots=True)
class CalibrationOptions:
    """Options of `rig benchmark calibration`."""

    trials: Annotated[int, typer.Option("--trials", min=20, help="Hand-eye trials.")] = 200


def _count(number: int) -> str:
    return str(number) if number else ""


@dataclass(frozen=True, slots=True)
class BadDataRow:
    """A case of bad data: how many of its draws were refused, answered right, or answered wrong."""

    group: str = column("bad data")
    case: str = column("case")
    refused: int = column("refused", _count)
    right: int = column("right", _count)
    wrong: int = column("wrong", _count)
    said: str = column("said", lambda said: said[:70], "an example of the refusals or answers")


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
    cases = [
        *degenerate_hand_eye.cases(),
        *degenerate_images.cases(),
        *degenerate_views.cases(),
        *degenerate_streams.cases(),
        *degenerate_gel.cases(),
    ]
    found = run_cases(cases, seed)
    bad = [BadDataRow(of.case.group, of.case.name, of.refused, of.right, of.wrong, of.said) for of in found]
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
