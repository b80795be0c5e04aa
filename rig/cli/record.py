"""`rig record`: grasp an object in many poses and keep the tactile images."""

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.errors import InputError, counted
from rig.cli.common import ask, emit_json, say
from rig.cli.declared import resumed, stored_as
from rig.cli.dry_run import dry_run
from rig.cli.options import BenchOptions, SessionOptions, WatchOptions
from rig.cli.report import report_after
from rig.cli.resuming import continued, may_be_continued
from rig.cli.watching import Work, telling, watched

if TYPE_CHECKING:
    from rig.experiments.pose_attempt import RecordSettings
    from rig.sessions.records import PoseRow
    from rig.sessions.remarks import Remarks


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """The object, and the number of poses and images."""

    object_name: Annotated[
        str | None, typer.Option("--object", help="Object id or name; needed unless a session is continued.")
    ] = stored_as("objects", None, lambda objects: objects[0])
    poses: Annotated[
        int | None,
        typer.Option(
            "--poses", min=1, max=720, help="Accepted grasp poses; default: all of the object's file, 15."
        ),
    ] = stored_as("poses", None)
    images: Annotated[
        int, typer.Option("--images", min=2, max=100000, help="Accepted images in all, over both fingertips.")
    ] = stored_as("images", 225)
    randomise: Annotated[
        bool,
        typer.Option(
            "--randomise",
            help="Simulated sensors unlike those of a bench; another seed, other sensors.",
        ),
    ] = stored_as("randomised", False)


def record(
    context: typer.Context,
    what: RecordOptions,
    bench: BenchOptions,
    session: SessionOptions,
    watch: WatchOptions,
) -> None:
    """Grasp one object in all poses of its file at varied grip, and keep the images.

    The paper's objects have 3 positions x 5 orientations; one of your own may have fewer.

    Simulated recordings keep the true contacts under truth/masks, apart from what the rig sees: labels
    for rig train.

    Examples:
      rig record --object 7 --poses 15

      rig record --object mug --poses 15 --images 150 --out sessions/mug

      rig record --resume --out sessions/mug

      rig record --object 7 --poses 5 --images 50 --randomise --seed 3 --out training/07_3

      rig record --object 7 --watch-at 127.0.0.1:8080

    """
    from rig.experiments.record import recording_plan
    from rig.sessions.remarks import remarks_of

    remarks = remarks_of(session.name, session.note, session.tags, session.operator)
    folder, settings = _prepare(context, what, bench, session)
    if bench.dry:
        dry_run(settings.bench, recording_plan(settings), session.json)
    _record_all(context, folder, settings, remarks, session, watch, agreed=bench.yes)


def _prepare(
    context: typer.Context, what: RecordOptions, bench: BenchOptions, session: SessionOptions
) -> "tuple[Path, RecordSettings]":
    """Read the bench and the session to resume; return folder and settings. Raises `InputError`."""
    from protocols.grasps import find_grasp_file, grasp_poses
    from rig.config.calibrations import load_calibrated_bench
    from rig.config.objects import with_more, with_objects
    from rig.experiments.pose_attempt import RecordSettings
    from rig.sessions.manifest import RecordManifest

    config = with_objects(load_calibrated_bench(bench.bench, say), bench.bench, bench.own_objects)
    named = None if what.object_name is None else find_grasp_file(what.object_name, config.objects).id
    folder, stored = continued(RecordManifest, "record", config.name, session.out, session.resume, named)
    if stored is not None:
        config = with_more(config, stored.config.objects)
        what, bench = resumed(what, stored, context), resumed(bench, stored, context)
    if what.object_name is None:
        raise InputError("--object is missing: which object is grasped?")
    grasps = find_grasp_file(what.object_name, config.objects)
    poses = what.poses or len(grasp_poses(grasps))
    settings = RecordSettings(config, bench.seed, grasps, poses, what.images, what.randomise)
    say(
        f"{_mark(settings)}bench '{config.name}', seed {bench.seed}, object {grasps.id} {grasps.name}, "
        f"session {folder}"
    )
    return folder, settings


def _record_all(
    context: typer.Context,
    folder: Path,
    settings: "RecordSettings",
    remarks: "Remarks",
    session: SessionOptions,
    watch: WatchOptions,
    agreed: bool,
) -> None:
    """Record the poses that are missing, and print and report the results."""
    from rig.bench.operators import ConsoleOperator
    from rig.bench.source import session_bench
    from rig.cli.printing import OneMessage, WorkProgress
    from rig.experiments.record import recording_plan, run_record
    from rig.live.feed import LiveFeed
    from rig.sessions.rows import read_poses

    began, mark, config = time.perf_counter(), _mark(settings), settings.bench
    question = f"{recording_plan(settings).text()}\nBegin?"
    person, said = ConsoleOperator(ask, agreed=agreed), OneMessage(_note, lambda row: row.fault)
    work = Work(f"{mark}recording on bench '{config.name}', {folder}", "poses", settings.poses)
    with (
        may_be_continued(
            folder,
            session.out,
            session.resume,
            session.no_report,
            lambda: say(mark + _images_text(read_poses(folder))),
        ),
        watched(context, work, watch) as listeners,
        session_bench(config, person, question, variation_seed=settings.variation_seed) as benches,
        WorkProgress(settings.poses, "poses") as bar,
    ):
        rows = run_record(
            folder,
            settings,
            session.resume,
            benches,
            telling(lambda done, total, row: bar.show(done, total, said(row)), _note, lambda row: row.fault),
            remarks,
            LiveFeed(listeners),
        )
    wall_s = round(time.perf_counter() - began, 2)
    say(f"{mark}{_images_text(rows)}, {wall_s:.1f} s")
    page = report_after(folder, session.no_report)
    if session.json:
        emit_json({"session": str(folder), **_figures(rows), "wall_s": wall_s, "report": page})
    else:
        print(folder)


def _mark(settings: "RecordSettings") -> str:
    return "SIMULATED " if settings.bench.simulated else ""


def _figures(rows: "list[PoseRow]") -> dict[str, int]:
    return {
        "poses_accepted": sum(row.accepted for row in rows),
        "images_accepted": sum(len(row.images) for row in rows),
        "images_rejected": sum(row.rejected_frames for row in rows),
    }


def _images_text(rows: "list[PoseRow]") -> str:
    figures = _figures(rows)
    return (
        f"{counted(figures['images_accepted'], 'image')} in {counted(figures['poses_accepted'], 'pose')}, "
        f"{counted(figures['images_rejected'], 'frame')} without contact rejected"
    )


def _note(row: "PoseRow") -> str:
    where = f"{row.position} at {row.orientation_deg:+.0f} deg"
    if not row.accepted:
        return f"{where}: {row.fault}"
    return f"{where}: {counted(len(row.images), 'image')}, {counted(row.rejected_frames, 'frame')} rejected"
