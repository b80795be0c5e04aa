"""`rig record`: grasp an object in many poses and store the tactile images."""

import time
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from drivers.errors import InputError, counted
from rig.cli.common import mark, print_result, say
from rig.cli.options import BenchOptions, SessionOptions, WatchOptions
from rig.cli.report import report_after
from rig.cli.resuming import agreed, bench_of, continued, dry_run, may_be_continued, watched
from rig.declared import option, resumed
from rig.terminal.onlookers import announcing
from rig.terminal.questions import ask

if TYPE_CHECKING:
    from rig.experiments.record import RecordSettings
    from rig.sessions.records import PoseRow

FAULT = attrgetter("fault")


@dataclass(frozen=True, slots=True)
class RecordOptions:
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


def record(
    context: typer.Context,
    what: RecordOptions,
    bench: BenchOptions,
    session: SessionOptions,
    watch: WatchOptions,
) -> None:
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
    from rig.bench.operators import ConsoleOperator
    from rig.bench.source import session_bench
    from rig.experiments.record import recording_plan, run_record
    from rig.live.feed import LiveFeed
    from rig.sessions.rows import read_poses
    from rig.terminal.progress import OneMessage, WorkProgress

    remarks = session.remarks()
    folder, settings = _prepare(context, what, bench, session)
    if bench.dry:
        dry_run(settings.bench, recording_plan(settings), session.json)
    began, config = time.perf_counter(), settings.bench
    simulated, question = mark(config.simulated), f"{recording_plan(settings).text()}\nBegin?"
    person, message = ConsoleOperator(ask, agreed=agreed(context, bench, config)), OneMessage(_note, FAULT)
    person.feeder = config.feeder
    title = f"{simulated}recording on bench '{config.name}', {folder}"
    with (
        may_be_continued(folder, session, lambda: say(simulated + _images(read_poses(folder))[1])),
        watched(context, watch, title, "poses", settings.poses) as listeners,
        session_bench(config, person, question, variation_seed=settings.variation_seed) as benches,
        WorkProgress(settings.poses, "poses") as bar,
    ):
        progress = announcing(bar.showing(message), _note, FAULT)
        feed = LiveFeed(listeners)
        rows = run_record(folder, settings, session.resume, benches, progress, remarks, feed)
    wall_s = round(time.perf_counter() - began, 2)
    figures, text = _images(rows)
    say(f"{simulated}{text}, {wall_s:.1f} s")
    about = {"wall_s": wall_s, "report": report_after(folder, session.no_report)}
    print_result(session.json, {"session": str(folder), **figures, **about}, folder)


def _prepare(
    context: typer.Context, what: RecordOptions, bench: BenchOptions, session: SessionOptions
) -> "tuple[Path, RecordSettings]":
    """Read the bench and the session to resume; return folder and settings. Raises `InputError`."""
    from protocols.grasps import find_grasp_file, grasp_poses
    from rig.config.objects import with_more
    from rig.config.parts import require_parts
    from rig.experiments.record import RecordSettings, record_manifest
    from rig.sessions.manifest import RecordManifest
    from rig.sessions.session import require_same

    # With --resume the manifest, which is read below, states whether the arm or a hand holds the object.
    by_hand = what.by == "hand" or session.resume
    config = bench_of(context, bench, session, "rig record --by hand" if by_hand else "rig record")
    named = None if what.object_name is None else find_grasp_file(what.object_name, config.objects).id
    folder, stored = continued(RecordManifest, "record", config.name, session, named)
    if stored is not None:
        config = with_more(config, stored.config.objects)
        what, bench = resumed(what, stored, context), resumed(bench, stored, context)
    if what.by == "arm":
        require_parts(config, "rig record")
    elif config.fakes is not None:
        raise InputError(
            f"--by hand: the sensors of bench '{config.name}' are simulated over the wire protocols and "
            "cannot be pressed by hand; use --bench fake, or real sensors"
        )
    else:
        config = config.fingertips_alone()  # so that no other device is used
    if what.object_name is None:
        raise InputError("--object is missing: name the object to grasp")
    grasps = find_grasp_file(what.object_name, config.objects)
    poses = what.poses or len(grasp_poses(grasps))
    say(
        f"{mark(config.simulated)}bench '{config.name}', seed {bench.seed}, "
        f"object {grasps.id} {grasps.name}, session {folder}"
    )
    settings = RecordSettings(config, bench.seed, grasps, poses, what.images, what.randomise, what.by)
    if stored is not None:
        require_same(folder, stored, record_manifest(settings))
    return folder, settings


def _images(rows: "list[PoseRow]") -> tuple[dict[str, int], str]:
    poses, images = sum(row.accepted for row in rows), sum(len(row.images) for row in rows)
    rejected = sum(row.rejected_frames for row in rows)
    text = (
        f"{counted(images, 'image')} in {counted(poses, 'pose')}, "
        f"{counted(rejected, 'frame')} without contact rejected"
    )
    return {"poses_accepted": poses, "images_accepted": images, "images_rejected": rejected}, text


def _note(row: "PoseRow") -> str:
    where = f"{row.position} at {row.orientation_deg:+.0f} deg"
    if not row.accepted:
        return f"{where}: {row.fault}"
    return f"{where}: {counted(len(row.images), 'image')}, {counted(row.rejected_frames, 'frame')} rejected"
