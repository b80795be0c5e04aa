"""What the commands of `rig calibrate` share: options, where files go, and what is said at the end."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.common import ask, emit_json, say, tell
from rig.cli.dry_run import dry_run
from rig.cli.places import folder_place
from rig.cli.watching import Work, watched
from rig.live.phases import begin_phase

if TYPE_CHECKING:
    from drivers.types import Frame
    from rig.bench.plan import Plan
    from rig.calibrate.bench import Station
    from rig.calibrate.result import CalibrationResult, Filed
    from rig.live.feed import Listener

FromOption = Annotated[Path | None, typer.Option("--from", help="Folder of recorded samples.")]
OutFolder = Annotated[
    Path | None,
    typer.Option("--out", help="Folder of the calibration file and its page.", callback=folder_place),
]
TargetOption = Annotated[
    str,
    typer.Option(
        "--target",
        help="charuco:8x6:25:18:DICT_5X5_100[:legacy], chessboard:9x6:25[:px], marker:60:DICT_4X4_50:0.",
    ),
]
CameraFile = Annotated[Path | None, typer.Option("--camera", help="Camera file: ours, ROS or OpenCV.")]
CameraSerial = Annotated[str, typer.Option("--serial", help="Of the camera.")]
PicturesOption = Annotated[str, typer.Option("--pictures", help="Which pictures of the folder.")]
PosesOption = Annotated[int, typer.Option("--poses", min=5, max=60, help="Poses to visit on a bench.")]


@contextmanager
def station(context: typer.Context, what: str, total: int, agreed: bool = False) -> "Iterator[Station]":
    """Where a calibration is collected, who is asked before something moves, and who looks on.

    context: of the command, whose options of a bench are read by their names. what, total: what its pieces
    of work are called, and how many there are. agreed: to everything, as with --yes. With --dry-run the
    plan is shown, as `dry_run` does, and that is all. Raises `InputError`.
    """
    from rig.bench.operators import ConsoleOperator
    from rig.calibrate.bench import Station
    from rig.config import load_bench
    from rig.config.objects import with_objects

    typed = context.params
    bench, dry = typed["bench"], typed["dry"]
    config = with_objects(load_bench(bench), bench, typed.get("objects"))
    simulated = "SIMULATED " if config.simulated else ""
    title = f"{simulated}calibrate {context.info_name} on bench '{config.name}'"
    say(title)
    asked = (False, None, None) if dry else (typed["watch"], typed["watch_at"], typed["notify"])
    with ExitStack() as stack:
        listeners = stack.enter_context(watched(context, Work(title, what, total), *asked))
        yield Station(
            config, typed["seed"], _folder(typed["out"], bench),
            ConsoleOperator(ask, agreed or typed["yes"], tell), say,
            partial(dry_run, config, json=typed["json"]) if dry else _nothing,
            _show(stack, listeners),
        )  # fmt: skip


def _show(stack: ExitStack, listeners: "tuple[Listener, ...]") -> "Callable[[Frame], None] | None":
    """Who takes frames for those who look on; nobody, and nothing of it imported, where nobody does."""
    if not listeners:
        return None
    from rig.live.feed import LiveFeed
    from rig.live.pictures import PictureSender

    return stack.enter_context(closing(PictureSender(LiveFeed(listeners))))


def recorded(context: typer.Context, source: Path) -> Path:
    """Return the folder of --from. Raises `InputError` where somebody is to look on at it."""
    from drivers.errors import InputError

    for option in ("watch", "watch_at", "notify"):
        if context.params[option]:
            named = option.replace("_", "-")
            raise InputError(f"--{named} looks on at a bench, and --from {source} needs none: leave it out")
    begin_phase(f"calibrating from {source}")
    return source


def _nothing(plan: "Plan") -> None:
    """Go on."""


def _folder(out: Path | None, bench: str) -> Path:
    """Where calibrations go: --out, or where trials on the bench look for them."""
    from rig.config.calibrations import calibrations_folder

    return out or calibrations_folder(bench)


def file_all(results: Sequence["CalibrationResult"], out: Path | None, bench: str, json: bool) -> None:
    """File the results of one collection; one that is refused is raised after all are on disk."""
    from drivers.errors import CalibrationError

    filed: list[Filed] = []
    refused: list[CalibrationError] = []
    for result in results:
        try:
            filed.append(filed_and_said(result, out, bench))
        except CalibrationError as error:
            refused.append(error)
            say(str(error))
    if json:
        emit_json({"calibrations": [each.figures for each in filed], "refused": [str(e) for e in refused]})
    else:
        for each in filed:
            print(each.path, each.page, sep="\n")
    if refused:
        raise CalibrationError(f"{len(refused)} of {len(results)} were refused; see their pages")


def file_and_say(result: "CalibrationResult", out: Path | None, bench: str, json: bool) -> None:
    """File a result, and print its verdict, figures and paths."""
    filed = filed_and_said(result, out, bench)
    if json:
        emit_json(filed.figures)
    else:
        print(filed.path)
        print(filed.page)


def filed_and_said(result: "CalibrationResult", out: Path | None, bench: str) -> "Filed":
    """File a result and print its verdict and figures. Raises `CalibrationError` for a refused one."""
    from rig.calibrate.result import file_result

    filed = file_result(result, _folder(out, bench))
    about = ", ".join(f"{role} {serial}" for role, serial in result.serials.items())
    say(f"{'SIMULATED ' if result.simulated else ''}{result.kind} calibration, {about}: {result.assessment}")
    for name, text in result.numbers.items():
        say(f"  {name}: {text}")
    for left_out in result.rejected:
        say(f"  left out {left_out.id}: {left_out.reason}")
    return filed
