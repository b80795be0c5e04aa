"""`rig record`: grasp an object in many poses and store the tactile images."""

import time
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from drivers.errors import InputError, plural
from rig.cli.common import mark, print_result, say
from rig.cli.options import RunOptions
from rig.cli.report import report_after
from rig.cli.resuming import (
    bench_of,
    dry_run,
    may_be_continued,
    person_at,
    serve_watch_page,
    session_to_continue,
)
from rig.declared import option, resume_options
from rig.terminal.onlookers import announcing

if TYPE_CHECKING:
    from rig.experiments.record import RecordSettings
    from rig.sessions.records import PoseRow


@dataclass(frozen=True)
class PoseOptions:
    object_name: str | None = option(
        None,
        "Object, by id or name. Required, except with --resume.",
        "--object",
        stored="objects",
        read=lambda objects: objects[0],
    )
    by: Literal["arm", "hand"] = option(
        "arm", "arm: the arm grasps the object. hand: you press the object onto the gels.", stored="by"
    )
    poses: int | None = option(
        None,
        "Number of accepted grasp poses. Default: all poses of the object's file (paper: 15).",
        min=1,
        max=720,
        stored="poses",
    )
    images: int = option(
        225, "Number of accepted images, of both fingertips together.", min=2, max=100000, stored="images"
    )
    randomise: bool = option(
        False, "Simulate sensors with random properties, which depend on --seed.", stored="randomised"
    )


@dataclass(frozen=True)
class RecordOptions(RunOptions, PoseOptions):
    pass


def record(context: typer.Context, options: RecordOptions) -> None:
    """Grasp one object in all poses of its file with varied grip, and store the tactile images.

    The paper's objects have 3 positions x 5 orientations. An object of your own may have fewer.

    --by hand needs no arm and no gripper: you press the object onto each gel, and confirm each pose.

    Simulated recordings also store the true contact masks in truth/masks, as labels for rig train.

    Examples:
      rig record --object 7 --poses 15
      rig record --object mug --poses 15 --images 150 --out sessions/mug
      rig record --resume --out sessions/mug
      rig record --object 7 --poses 5 --images 50 --randomise --seed 3 --out training/07_3
      rig record --object 7 --watch-at 127.0.0.1:8080
    """
    from rig.bench.source import session_bench
    from rig.experiments.record import recording_plan, run_record
    from rig.sessions.rows import read_poses
    from rig.terminal.progress import OneMessage, WorkProgress

    remarks = options.remarks()
    folder, settings = _prepare(context, options)
    plan, config = recording_plan(settings), settings.bench
    if options.dry:
        dry_run(config, plan, options.json)
    began, simulated, fault = time.perf_counter(), mark(config.simulated), attrgetter("fault")
    person, message = person_at(context, options, config), OneMessage(_note, fault)
    title = f"{simulated}recording on bench '{config.name}', {folder}"
    with (
        may_be_continued(folder, options, lambda: say(simulated + _images(read_poses(folder))[1])),
        serve_watch_page(context, options, title, "poses", settings.poses) as listeners,
        session_bench(
            config, person, f"{plan.text()}\nBegin?", variation_seed=settings.variation_seed
        ) as benches,
        WorkProgress(settings.poses, "poses") as bar,
    ):
        progress = announcing(bar.showing(message), _note, fault)
        rows = run_record(folder, settings, options.resume, benches, progress, remarks, listeners)
    wall_s = round(time.perf_counter() - began, 2)
    figures, text = _images(rows)
    say(f"{simulated}{text}, {wall_s:.1f} s")
    about = {"wall_s": wall_s, "report": report_after(folder, options.no_report)}
    print_result(options.json, {"session": str(folder), **figures, **about}, folder)


def _prepare(context: typer.Context, options: RecordOptions) -> "tuple[Path, RecordSettings]":
    """Read the bench and the session to resume; return folder and settings. Raises `InputError`."""
    from protocols.grasps import find_grasp_file, grasp_poses
    from rig.config.objects import with_more
    from rig.config.parts import require_parts
    from rig.experiments.record import RecordSettings, record_manifest
    from rig.sessions.manifest import RecordManifest
    from rig.sessions.session import require_same

    # With --resume the manifest, which is read below, states whether the arm or a hand holds the object.
    by_hand = options.by == "hand" or options.resume
    config = bench_of(context, options, "rig record --by hand" if by_hand else "rig record")
    name = options.object_name
    named = None if name is None else find_grasp_file(name, config.objects).id
    folder, stored = session_to_continue(RecordManifest, "record", config.name, options, named)
    if stored is not None:
        config = with_more(config, stored.config.objects)
        options = resume_options(options, stored, context)
    if options.by == "arm":
        require_parts(config, "rig record")
    elif config.fakes is not None:
        raise InputError(
            f"--by hand: the sensors of bench '{config.name}' are simulated over the wire protocols and "
            "cannot be pressed by hand; use --bench fake, or real sensors"
        )
    else:
        config = config.fingertips_alone()  # so that no other device is used
    if options.object_name is None:
        raise InputError("--object is missing: name the object to grasp")
    grasps = find_grasp_file(options.object_name, config.objects)
    say(
        f"{mark(config.simulated)}bench '{config.name}', seed {options.seed}, "
        f"object {grasps.id} {grasps.name}, session {folder}"
    )
    poses = options.poses or len(grasp_poses(grasps))
    settings = RecordSettings(
        config, options.seed, grasps, poses, options.images, options.randomise, options.by
    )
    if stored is not None:
        require_same(folder, stored, record_manifest(settings))
    return folder, settings


def _images(rows: "list[PoseRow]") -> tuple[dict[str, int], str]:
    poses, images = sum(row.accepted for row in rows), sum(len(row.images) for row in rows)
    rejected = sum(row.rejected_frames for row in rows)
    text = (
        f"{plural(images, 'image')} in {plural(poses, 'pose')}, "
        f"{plural(rejected, 'frame')} without contact rejected"
    )
    return {"poses_accepted": poses, "images_accepted": images, "images_rejected": rejected}, text


def _note(row: "PoseRow") -> str:
    where = f"{row.position} at {row.orientation_deg:+.0f} deg"
    if not row.accepted:
        return f"{where}: {row.fault}"
    return f"{where}: {plural(len(row.images), 'image')}, {plural(row.rejected_frames, 'frame')} rejected"
