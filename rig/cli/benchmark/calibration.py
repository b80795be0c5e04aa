"""`rig benchmark calibration`: the limits the calibrations have to keep."""

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.common import Exit, JsonOption, SeedOption, emit_json, say
from rig.cli.places import folder_place

if TYPE_CHECKING:
    from rich.table import Table

    from rig.benchmark.calibration.benchmark import CalibrationReport


def calibration(
    trials: Annotated[int, typer.Option("--trials", min=20, help="Hand-eye trials.")] = 200,
    seed: SeedOption = 0,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder for results.json.", callback=folder_place)
    ] = None,
    json: JsonOption = False,
) -> None:
    """Measure the calibrations against their limits, on simulated and, where they are, real data.

    Exit code 4 when a limit is missed, or bad data went through without being refused.

    Examples:
      rig benchmark calibration

      rig benchmark calibration --trials 50 --json

    """
    import os
    import time

    # many small matrices: threads of the linear algebra only wait for one another
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from rig.benchmark.calibration.benchmark import run

    began = time.perf_counter()
    report = run(say, seed, trials)
    figures = {**_plain(report), "wall_s": round(time.perf_counter() - began, 1)}
    if out is not None:
        from rig.sessions.files import write_json

        out.mkdir(parents=True, exist_ok=True)
        write_json(out / "results.json", figures)
    if json:
        emit_json(figures)
    else:
        _print(report)
        say(f"{figures['wall_s']:.0f} s")
    if not report.passed:
        say("rig: a limit was missed, or bad data went through: see the table")
        raise typer.Exit(Exit.LIMIT_MISSED)


def _plain(report: "CalibrationReport") -> dict[str, object]:
    rows = [{"name": r.name, "value": r.value, "asked": r.asked, "met": r.met} for r in report.rows]
    cases = [
        {"group": c.case.group, "case": c.case.name, "said": c.said}
        | {"refused": c.refused, "right": c.right, "wrong": c.wrong}
        for c in report.cases
    ]  # fmt: skip
    angles = [asdict(score) for score in report.angles]
    return {"passed": report.passed, "measured": rows, "marker_angle": angles, "bad_data": cases}


def _angle_table(report: "CalibrationReport") -> "Table":
    from rich.table import Table

    ways = list(dict.fromkeys(score.way for score in report.angles))
    table = Table(
        "two-marker angle, SIMULATED",
        *ways,
        title="rms error, worst, deg (mean at rest); answered unless all; ms of processor time per picture",
    )
    for scene in dict.fromkeys(score.scene for score in report.angles):
        cells = []
        for score in (score for score in report.angles if score.scene == scene):
            answered = "" if score.answered == 1.0 else f" {score.answered:.0%}"
            figures = f"{score.rms_deg:.4f}, {score.worst_deg:.3f} ({score.rest_deg:+.4f})"
            cells.append(f"{figures}{answered}; {score.ms:.2f}")
        table.add_row(scene, *cells)
    return table


def _print(report: "CalibrationReport") -> None:
    from rich.table import Table

    from rig.cli.fitting import table_console

    console = table_console()
    table = Table(
        "measured", "value", "asked", "", title="Calibrations: simulated data unless 'real' or 'photos'"
    )
    for row in report.rows:
        verdict = {None: "", True: "met", False: "MISSED"}[row.met]
        table.add_row(row.name, "" if row.value is None else f"{row.value:.3g}", row.asked, verdict)
    console.print(table)
    console.print(_angle_table(report))
    bad = Table(
        "bad data",
        "case",
        "refused",
        "right",
        "wrong",
        "said",
        title="Refused with the right reason, or right",
    )
    for case in report.cases:
        counts = (str(n) if n else "" for n in (case.refused, case.right, case.wrong))
        bad.add_row(case.case.group, case.case.name, *counts, case.said[:70])
    console.print(bad)
    total = [sum(getattr(case, kind) for case in report.cases) for kind in ("refused", "right", "wrong")]
    console.print(f"{len(report.cases)} cases: {total[0]} refused, {total[1]} right, {total[2]} wrong")
