"""Shared by the commands of `rig calibrate`: options, collection of samples, files and printed results."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rig.cli.common import mark, print_result, say
from rig.cli.options import BenchOption, DryRunOption, JsonOption, SeedOption, WatchOptions, YesOption
from rig.cli.resuming import dry_run, watched
from rig.declared import folder_place, option
from rig.terminal.questions import ask, ask_line
from rig.terminal.screen import begin_phase

if TYPE_CHECKING:
    from drivers.types import Frame
    from rig.calibrate.bench import Station
    from rig.calibrate.result import CalibrationResult, Filed
    from rig.live.feed import Listener

TargetOption = Annotated[
    str,
    typer.Option(
        "--target",
        help="Target (squares, sizes in mm, ArUco dictionary): charuco:8x6:25:18:DICT_5X5_100 (append "
        ":legacy for the pattern of OpenCV before 4.6), chessboard:9x6:25[:px] or marker:60:DICT_4X4_50:0.",
    ),
]
CameraFile = Annotated[Path | None, typer.Option("--camera", help="Camera file of the rig, ROS or OpenCV.")]
CameraSerial = Annotated[str, typer.Option("--serial", help="Serial of the camera.")]
PicturesOption = Annotated[
    str, typer.Option("--pictures", help="With --from: pattern of the picture files, as 'left*.jpg'.")
]
PosesOption = Annotated[int, typer.Option("--poses", min=5, max=60, help="On a bench: number of poses.")]


@dataclass(frozen=True, slots=True)
class StationOptions(WatchOptions):
    """The source of a calibration's samples, and the folder of its file."""

    source: Path | None = option(None, "Folder of recorded samples. Default: collect on --bench.", "--from")
    bench: BenchOption = "fake"
    seed: SeedOption = 0
    dry: DryRunOption = False
    yes: YesOption = False
    out: Path | None = option(None, "Folder for the calibration file and its page.", callback=folder_place)
    json: JsonOption = False

    @property
    def folder(self) -> Path:
        """Folder of the calibration files: --out, by default the folder that trials on the bench read."""
        from rig.config.calibrations import calibrations_folder

        return self.out or calibrations_folder(self.bench)


def calibrated(
    context: typer.Context,
    common: StationOptions,
    work: tuple[str, int],
    on_bench: "Callable[[Station], CalibrationResult | Sequence[CalibrationResult]]",
    from_folder: "Callable[[Path], CalibrationResult]",
    **settings: Any,
) -> None:
    """Calibrate from the folder of --from, or on the bench without it; store and print the results.

    on_bench: calibrates on the bench. from_folder: calibrates from the samples of a folder. work: name and
    number of the items for the watch page. settings: further arguments of `_station`.
    """
    if common.source is not None:
        _file_one(from_folder(_recorded(common.source, common)), common)
        return
    with _station(context, common, *work, **settings) as at:
        found = on_bench(at)
        if isinstance(found, Sequence):
            _file_all(found, common)
        else:
            _file_one(found, common)


@contextmanager
def _station(
    context: typer.Context,
    common: StationOptions,
    what: str,
    total: int,
    agreed: bool = False,
    objects: Path | None = None,
    needs: str = "",
) -> "Iterator[Station]":
    """Yield the station of a collection: the bench, the operator, and the folder of the results.

    what, total: name and number of the items for the watch page. agreed: whether every question is agreed to,
    as with --yes. objects: folder of own objects. needs: name in `rig.config.parts.NEEDS`, by default that of
    the command. With --dry-run the plan is shown, as by `dry_run`, and the command ends. Raises `InputError`.
    """
    from rig.bench.operators import ConsoleOperator
    from rig.calibrate.bench import Station
    from rig.config import load_bench
    from rig.config.objects import with_objects
    from rig.config.parts import require_parts

    config = with_objects(load_bench(common.bench), common.bench, objects)
    require_parts(config, needs or f"rig calibrate {context.info_name}")
    title = (
        f"{mark(config.simulated and not config.mixed)}calibrate {context.info_name} on bench '{config.name}'"
    )
    say(title)
    with ExitStack() as stack:
        watch = WatchOptions() if common.dry else common
        listeners = stack.enter_context(watched(context, watch, title, what, total))
        yield Station(
            config,
            common.seed,
            common.folder,
            ConsoleOperator(ask, agreed or common.yes, ask_line),
            say,
            partial(dry_run, config, json=common.json) if common.dry else lambda plan: None,
            _show(stack, listeners),
        )


def _show(stack: ExitStack, listeners: "tuple[Listener, ...]") -> "Callable[[Frame], None] | None":
    """Return the function that sends frames to the watch page; None if there is no page."""
    if not listeners:
        return None
    from rig.live.feed import LiveFeed
    from rig.live.observer import PictureSender

    return stack.enter_context(closing(PictureSender(LiveFeed(listeners))))


def _recorded(source: Path, common: StationOptions) -> Path:
    """Return the folder of --from. Raises `InputError` if an option of the watch page was given with it."""
    from drivers.errors import InputError

    for name in ("watch", "watch_at"):
        if getattr(common, name):
            named = name.replace("_", "-")
            raise InputError(f"--{named} is for a calibration on a bench: leave it out with --from {source}")
    begin_phase(f"calibrating from {source}")
    return source


def _file_all(results: "Sequence[CalibrationResult]", common: StationOptions) -> None:
    """Store the results of one collection. Raises `CalibrationError` at the end if any is refused."""
    from drivers.errors import CalibrationError

    filed: list[Filed] = []
    refused: list[str] = []
    for result in results:
        try:
            filed.append(_filed(result, common))
        except CalibrationError as error:
            refused.append(str(error))
            say(str(error))
    figures = {"calibrations": [each.figures for each in filed], "refused": refused}
    print_result(common.json, figures, *(path for each in filed for path in (each.path, each.page)))
    if refused:
        raise CalibrationError(f"{len(refused)} of {len(results)} calibrations were refused; see their pages")


def _file_one(result: "CalibrationResult", common: StationOptions) -> None:
    """Store a result; print its verdict, figures and paths. Raises `CalibrationError` if it is refused."""
    filed = _filed(result, common)
    print_result(common.json, filed.figures, filed.path, filed.page)


def _filed(result: "CalibrationResult", common: StationOptions) -> "Filed":
    """Store a result; print the rejected samples, its verdict and figures.

    Raises `CalibrationError` if it is refused, after printing why samples were rejected.
    """
    from calibration.verdict import counted_reasons
    from rig.calibrate.result import file_result

    for line in counted_reasons(result.rejected):
        say(f"left out {line}")
    filed = file_result(result, common.folder)
    about = ", ".join(f"{role} {serial}" for role, serial in result.serials.items())
    say(f"{mark(result.simulated)}{result.kind} calibration, {about}: {result.assessment}")
    for name, text in result.numbers.items():
        say(f"  {name}: {text}")
    return filed
