"""`rig record`: grasp an object in many poses and keep the tactile images."""

from typing import TYPE_CHECKING, Annotated

import typer

from drivers.errors import counted
from rig.cli.common import (
    BenchOption,
    JsonOption,
    NameOption,
    NoteOption,
    ObjectsOption,
    OperatorOption,
    OutOption,
    ResumeStoredOption,
    SeedOption,
    TagOption,
    YesOption,
    ask,
    emit_json,
    say,
)
from rig.cli.dry_run import DryRunOption, dry_run
from rig.cli.report import NoReportOption, report_after
from rig.cli.resuming import continued, given, may_be_continued
from rig.cli.watching import NotifyOption, WatchAtOption, WatchOption, Work, telling, watched

if TYPE_CHECKING:
    from rig.sessions.records import PoseRow


def record(
    context: typer.Context,
    object_name: Annotated[
        str | None, typer.Option("--object", help="Object id or name; needed unless a session is continued.")
    ] = None,
    poses: Annotated[
        int | None,
        typer.Option(
            "--poses", min=1, max=720, help="Accepted grasp poses; default: all of the object's file, 15."
        ),
    ] = None,
    images: Annotated[
        int, typer.Option("--images", min=2, max=100000, help="Accepted images in all, over both fingertips.")
    ] = 225,
    own_objects: ObjectsOption = None,
    randomise: Annotated[
        bool,
        typer.Option(
            "--randomise",
            help="Simulated sensors unlike those of a bench; another seed, other sensors.",
        ),
    ] = False,
    seed: SeedOption = 0,
    bench: BenchOption = "fake",
    name: NameOption = None,
    note: NoteOption = None,
    tags: TagOption = None,
    operator: OperatorOption = None,
    out: OutOption = None,
    resume: ResumeStoredOption = False,
    no_report: NoReportOption = False,
    dry: DryRunOption = False,
    yes: YesOption = False,
    json: JsonOption = False,
    watch: WatchOption = False,
    watch_at: WatchAtOption = None,
    notify: NotifyOption = None,
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
    import time

    from drivers.errors import InputError
    from protocols.grasps import find_grasp_file, grasp_poses
    from rig.bench.operators import ConsoleOperator
    from rig.bench.source import session_bench
    from rig.cli.printing import OneMessage, WorkProgress
    from rig.config.calibrations import load_calibrated_bench
    from rig.config.objects import with_more, with_objects
    from rig.experiments.pose_attempt import RecordSettings
    from rig.experiments.record import recording_plan, run_record
    from rig.live.feed import LiveFeed
    from rig.sessions.manifest import RecordManifest
    from rig.sessions.remarks import remarks_of
    from rig.sessions.rows import read_poses

    began = time.perf_counter()
    remarks = remarks_of(name, note, tags, operator)
    config = load_calibrated_bench(bench, say)
    config = with_objects(config, bench, own_objects)
    grasps = None if object_name is None else find_grasp_file(object_name, config.objects)
    folder, stored = continued(
        RecordManifest, "record", config.name, out, resume, grasps.id if grasps else None
    )
    if stored is not None:
        config = with_more(config, stored.config.objects)
        grasps = grasps or find_grasp_file(stored.objects[0], config.objects)
        poses = poses or stored.poses
        images = images if given(context, "images") else stored.images
        randomise = randomise or stored.randomised
        seed = seed if given(context, "seed") else stored.seed
    if grasps is None:
        raise InputError("--object is missing: which object is grasped?")
    poses = poses or len(grasp_poses(grasps))
    settings = RecordSettings(config, seed, grasps, poses, images, randomise)
    simulated = "SIMULATED " if config.simulated else ""
    say(f"{simulated}bench '{config.name}', seed {seed}, object {grasps.id} {grasps.name}, session {folder}")
    plan = recording_plan(settings)
    if dry:
        dry_run(config, plan, json)
    person = ConsoleOperator(ask, agreed=yes)
    said = OneMessage(_note, lambda row: row.fault)
    work = Work(f"{simulated}recording on bench '{config.name}', {folder}", "poses", poses)
    with (
        may_be_continued(
            folder, out, resume, no_report, lambda: say(simulated + _images_text(read_poses(folder)))
        ),
        watched(context, work, watch, watch_at, notify) as listeners,
        session_bench(
            config, person, f"{plan.text()}\nBegin?", variation_seed=settings.variation_seed
        ) as benches,
        WorkProgress(poses, "poses") as bar,
    ):
        rows = run_record(
            folder,
            settings,
            resume,
            benches,
            telling(lambda done, total, row: bar.show(done, total, said(row)), _note, lambda row: row.fault),
            remarks,
            LiveFeed(listeners),
        )
    wall_s = round(time.perf_counter() - began, 2)
    figures = {"session": str(folder), **_figures(rows), "wall_s": wall_s}
    say(f"{simulated}{_images_text(rows)}, {wall_s:.1f} s")
    page = report_after(folder, no_report)
    if json:
        emit_json({**figures, "report": page})
    else:
        print(folder)


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
