"""`rig export`: a session for other people's tools."""

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.common import JsonOption, emit_json, report_broken, say
from rig.cli.places import folder_place


def export(
    session: Annotated[Path, typer.Argument(help="Session folder of a trial or a recording.")],
    to: Annotated[str, typer.Option("--to", help="csv, parquet, coco, labelme, lerobot or rosbag2.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", help="New folder; default: export/FORMAT in the session.", callback=folder_place
        ),
    ] = None,
    every: Annotated[
        int,
        typer.Option("--every", min=1, help="coco, labelme: every Nth tactile frame of a trial."),
    ] = 10,
    json: JsonOption = False,
) -> None:
    """Write a session in a format that other tools open; the session itself stays as it is.

    csv, parquet: lifts, angles, arm, gripper, frames; or poses and images.

    coco, labelme: images with contact outlines, the true ones of simulated
    recordings, else proposals; the files say which.

    lerobot: a LeRobotDataset v3.0, an episode per lift.

    rosbag2: a ROS 2 bag per lift (MCAP), with standard messages.

    The recordings themselves, lifts/NNN.mcap, open in MCAP viewers as they are.

    Examples:
      rig export sessions/2026-11-21T093000_trial --to csv

      rig export sessions/2026-11-21T093000_trial --to lerobot --out /data/lifts

      rig export sessions/2026-11-21T101500_obj7_record --to labelme

    """
    import time

    from rig.export.formats import export_session
    from rig.live.screen import begin_phase

    began = time.perf_counter()
    folder = out or session / "export" / to
    begin_phase(f"exporting to {to}")
    exported = export_session(session, to, folder, every)
    wall_s = round(time.perf_counter() - began, 2)
    counts = ", ".join(f"{count} {name}" for name, count in exported.counts.items())
    say(f"{counts}, {wall_s:.1f} s")
    for note in exported.notes:
        say(note)
    if json:
        figures = {
            "counts": exported.counts,
            "notes": list(exported.notes),
            "left_out": list(exported.left_out),
            "wall_s": wall_s,
        }
        emit_json({"session": str(session), "to": to, "out": str(folder), **figures})
    else:
        print(folder)
    report_broken(exported.left_out)
