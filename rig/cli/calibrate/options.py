"""What the commands of `rig calibrate` share: options, where files go, and what is said at the end."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.common import BenchOption, JsonOption, SeedOption, YesOption, ask, emit_json, say, tell
from rig.cli.dry_run import dry_run
from rig.cli.options import DryRunOption, NotifyOption, WatchAtOption, WatchOption, WatchOptions
from rig.cli.places import folder_place
from rig.cli.watching import Work, watched
from rig.live.screen import begin_phase

if TYPE_CHECKING:
    from drivers.types import Frame
    from rig.bench.plan import Plan
    from rig.calibrate.bench import Station
    from rig.calibrate.result import CalibrationResult, Filed
    from rig.live.feed import Listener

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


@dataclass(frozen=True, slots=True)
class StationOptions:
    """Where the samples of a calibration come from, and where its file goes."""

    source: Annotated[Path | None, typer.Option("--from", help="Folder of recorded samples.")] = None
    bench: BenchOption = "fake"
    seed: SeedOption = 0
    dry: DryRunOption = False
    yes: YesOption = False
    out: Annotated[
        Path | None,
        typer.Option("--out", help="Folder of the calibration file and its page.", callback=folder_place),
    ] = None
    json: JsonOption = False
    watch: WatchOption = False
    watch_at: WatchAtOption = None
    notify: NotifyOption = None

    @property
    def folder(self) -> Path:
        """Folder of the calibration files: --out, or where trials on the bench read them."""
        from rig.config.calibrations import calibrations_folder

        return self.out or calibrations_folder(self.bench)


@contextmanager
def station(
    context: typer.Context,
    common: StationOptions,
    what: str,
    total: int,
    agreed: bool = False,
    objects: Path | None = None,
) -> "Iterator[Station]":
    """Yield the place of a collection: the bench, the person who is asked, and the folder of the results.

    what, total: name and number of the pieces of work. agreed: to every question, as with --yes. objects:
    folder of own objects. With --dry-run the plan is shown, as by `dry_run`, and the command ends. Raises
    `InputError`.
    """
    from rig.bench.operators import ConsoleOperator
    from rig.calibrate.bench import Station
    from rig.config import load_bench
    from rig.config.objects import with_objects

    config = with_objects(load_bench(common.bench), common.bench, objects)
    simulated = "SIMULATED " if config.simulated else ""
    title = f"{simulated}calibrate {context.info_name} on bench '{config.name}'"
    say(title)
    watch = WatchOptions() if common.dry else WatchOptions(common.watch, common.watch_at, common.notify)
    with ExitStack() as stack:
        listeners = stack.enter_context(watched(context, Work(title, what, total), watch))
        yield Station(
            config,
            common.seed,
            common.folder,
            ConsoleOperator(ask, agreed or common.yes, tell),
            say,
            partial(dry_run, config, json=common.json) if common.dry else _nothing,
            _show(stack, listeners),
        )


def _show(stack: ExitStack, listeners: "tuple[Listener, ...]") -> "Callable[[Frame], None] | None":
    """Who takes frames for those who look on; nobody, and nothing of it imported, where nobody does."""
    if not listeners:
        return None
    from rig.live.feed import LiveFeed
    from rig.live.observer import PictureSender

    return stack.enter_context(closing(PictureSender(LiveFeed(listeners))))


def recorded(source: Path, common: StationOptions) -> Path:
    """Return the folder of --from. Raises `InputError` if an option to watch a bench was given with it."""
    from drivers.errors import InputError

    for option in ("watch", "watch_at", "notify"):
        if getattr(common, option):
            named = option.replace("_", "-")
            raise InputError(f"--{named} watches a bench, and --from {source} needs none: leave it out")
    begin_phase(f"calibrating from {source}")
    return source


def _nothing(plan: "Plan") -> None:
    """Go on."""


def file_all(results: Sequence["CalibrationResult"], common: StationOptions) -> None:
    """File the results of one collection; one that is refused is raised after all are on disk."""
    from drivers.errors import CalibrationError

    filed: list[Filed] = []
    refused: list[CalibrationError] = []
    for result in results:
        try:
            filed.append(filed_and_said(result, common))
        except CalibrationError as error:
            refused.append(error)
            say(str(error))
    if common.json:
        emit_json({"calibrations": [each.figures for each in filed], "refused": [str(e) for e in refused]})
    else:
        for each in filed:
            print(each.path, each.page, sep="\n")
    if refused:
        raise CalibrationError(f"{len(refused)} of {len(results)} were refused; see their pages")


def file_and_say(result: "CalibrationResult", common: StationOptions) -> None:
    """File a result, and print its verdict, figures and paths."""
    filed = filed_and_said(result, common)
    if common.json:
        emit_json(filed.figures)
    else:
        print(filed.path)
        print(filed.page)


def filed_and_said(result: "CalibrationResult", common: StationOptions) -> "Filed":
    """File a result and print its verdict and figures. Raises `CalibrationError` for a refused one."""
    from rig.calibrate.result import file_result

    filed = file_result(result, common.folder)
    about = ", ".join(f"{role} {serial}" for role, serial in result.serials.items())
    say(f"{'SIMULATED ' if result.simulated else ''}{result.kind} calibration, {about}: {result.assessment}")
    for name, text in result.numbers.items():
        say(f"  {name}: {text}")
    for left_out in result.rejected:
        say(f"  left out {left_out.id}: {left_out.reason}")
    return filed
