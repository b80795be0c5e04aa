"""`rig export`: write a session in the formats of other tools."""

import time
from dataclasses import dataclass
from pathlib import Path

from rig.cli.common import print_result, report_broken, say
from rig.cli.options import JsonOption
from rig.declared import argument, folder_place, option
from rig.terminal.screen import begin_phase


@dataclass(frozen=True, slots=True)
class ExportOptions:
    session: Path = argument(..., "Session folder of a trial or a recording.")
    to: str = option(..., "Format: csv, parquet, coco, labelme, lerobot or rosbag2.")
    out: Path | None = option(
        None, "New folder to write. Default: export/FORMAT in the session.", callback=folder_place
    )
    every: int = option(10, "For coco and labelme: export every Nth tactile frame of a trial.", min=1)
    json: JsonOption = False


def export(options: ExportOptions) -> None:
    """Export a session to a format that other tools open. The session itself is not changed.

    csv, parquet: tables of lifts, angles, arm, gripper and frames; of a recording, poses and images.

    coco, labelme: images with outlines of the contact. They are ground truth for simulated recordings and
    proposals for others; the files state which.

    lerobot: a LeRobotDataset v3.0 with an episode per lift.

    rosbag2: a ROS 2 bag per lift (MCAP), with standard messages.

    The recordings, lifts/NNN.mcap, open in MCAP viewers without export.

    Examples:
      rig export sessions/2026-11-21T093000_trial --to csv
      rig export sessions/2026-11-21T093000_trial --to lerobot --out /data/lifts
      rig export sessions/2026-11-21T101500_obj7_record --to labelme
    """
    folder = options.out or options.session / "export" / options.to
    begin_phase(f"exporting to {options.to}")
    from rig.export.formats import export_session

    began = time.perf_counter()
    exported = export_session(options.session, options.to, folder, options.every)
    wall_s = round(time.perf_counter() - began, 2)
    counts = ", ".join(f"{name}: {count}" for name, count in exported.counts.items())
    say(f"{counts}; {wall_s:.1f} s")
    for note in exported.notes:
        say(note)
    notes, left_out = list(exported.notes), list(exported.left_out)
    figures = {"counts": exported.counts, "notes": notes, "left_out": left_out, "wall_s": wall_s}
    about = {"session": str(options.session), "to": options.to, "out": str(folder)}
    print_result(options.json, {**about, **figures}, folder)
    report_broken(exported.left_out)
