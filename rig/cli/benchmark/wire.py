"""`rig benchmark wire`: a lift with the real drivers, held against what the fakes served."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.common import Exit, JsonOption, emit_json, say, session_folder
from rig.cli.places import file_place, folder_place

if TYPE_CHECKING:
    from rig.benchmark.wire.lift import WireReport

LEAST_STATE_HZ = 490.0
MOST_CONTROLLER_CORE = 0.25


def wire(
    object_name: Annotated[str, typer.Option("--object", help="Object id or name.")] = "wrench",
    seeds: Annotated[
        int, typer.Option("--seeds", min=20, max=100, help="Lifts in this process whose spread is told.")
    ] = 20,
    out: Annotated[
        Path | None, typer.Option("--out", help="Session folder of the lift.", callback=folder_place)
    ] = None,
    live_to: Annotated[
        Path | None,
        typer.Option("--live-to", help="Have the live view look on, into FILE.rrd.", callback=file_place),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Do one lift on the bench behind wires, in real time: frames lost, rates, agreement.

    Exit code 4 when a frame that was served is not in the recording, the arm's driver took up fewer
    than 490 of its 500 states a second, the fake controller used more than a quarter of a core, a
    fingertip's angle came later than one frame period after its frame's capture (99th percentile), or
    the result is not that of the same lift in this process, within the spread over seeds.

    Examples:
      rig benchmark wire

      rig benchmark wire --object spam --json

      rig benchmark wire --live-to lift.rrd

    """
    from protocols.grasps import find_grasp_file
    from rig.benchmark.wire.lift import measure_wire
    from rig.live.session import viewer_feed

    folder = session_folder(out, False, "wire")
    say(f"SIMULATED bench 'wire', one lift in real time, session {folder}")
    with viewer_feed(live_to) as feed:
        report = measure_wire(folder, find_grasp_file(object_name).id, seeds, feed)
    missed = _missed(report)
    if json:
        emit_json({"session": str(folder), **_plain(report), "missed": missed})
    else:
        _print_table(report)
    for text in missed:
        say(f"rig: {text}")
    if missed:
        raise typer.Exit(Exit.LIMIT_MISSED)


def _missed(report: "WireReport") -> list[str]:
    limits = {
        "a frame that was served is not in the recording": report.complete,
        f"the arm's driver took up fewer than {LEAST_STATE_HZ:g} states a second": report.state_hz
        >= LEAST_STATE_HZ,
        f"the fake controller used more than {MOST_CONTROLLER_CORE:g} core": report.controller_core
        <= MOST_CONTROLLER_CORE,
        f"angles came later than {report.period_ms:.1f} ms after capture": report.latest_ms
        <= report.period_ms,
        "the result is not that of this process within the spread over seeds": report.agrees,
    }
    return [text for text, kept in limits.items() if not kept]


def _plain(report: "WireReport") -> dict[str, object]:
    from dataclasses import asdict

    return {
        "streams": [asdict(stream) for stream in report.streams],
        "state_hz": report.state_hz,
        "controller_core": report.controller_core,
        "wall_s": report.wall_s,
        "capture_to_angle": {serial: asdict(late) for serial, late in report.latency.items()},
        "outcome": report.row.outcome,
        "re_b_deg": report.row.re_b.mean_deg if report.row.re_b else None,
        "final_truth_deg": report.row.final_truth_deg,
        "agrees": report.agrees,
        "seeds_re_b_deg": report.errors_deg,
        "seeds_outcomes": [row.outcome for row in report.seeds],
    }


def _print_table(report: "WireReport") -> None:
    from rich.table import Table

    from rig.cli.fitting import table_console

    table = Table(
        "source", "served", "recorded", "missing", "capture to log, ms: median", "99 %",
        title="SIMULATED bench 'wire': frames of one lift",
    )  # fmt: skip
    for stream in report.streams:
        late = report.latency[stream.serial]
        counts = map(str, (stream.served, stream.recorded, stream.missing))
        table.add_row(stream.serial, *counts, f"{late.p50_ms:.1f}", f"{late.p99_ms:.1f}")
    console = table_console()
    console.print(table)
    console.print(
        f"arm states {report.state_hz:.1f}/s of 500, fake controller {report.controller_core:.2f} core, "
        f"{report.wall_s:.1f} s",
        highlight=False,
    )
    row, same, (mean, spread) = report.row, report.seeds[0], report.spread_deg
    found = f"{row.re_b.mean_deg:.2f} deg" if row.re_b else "none"
    console.print(
        f"{row.outcome}, true turn {row.final_truth_deg or 0.0:.1f} deg; in this process {same.outcome}, "
        f"{same.final_truth_deg or 0.0:.1f} deg\nmean error over phase B {found}; in this process "
        f"{mean:.2f} ± {spread:.2f} deg over {len(report.errors_deg)} seeds",
        highlight=False,
    )
