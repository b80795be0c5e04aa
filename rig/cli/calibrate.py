"""`rig calibrate`: write calibration files and pages, from recorded samples or on the bench.

The commands are made from the kinds of calibrations (`rig.calibrate.kind.Kind`).
"""

from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from drivers.errors import CalibrationError, InputError
from rig.cli.common import mark, print_result, say
from rig.cli.helping import Commands, Group, as_command
from rig.cli.options import BenchOption, DryRunOption, JsonOption, SeedOption, WatchOptions, YesOption
from rig.cli.resuming import dry_run, serve_watch_page
from rig.declared import file_place, folder_place, is_given, option
from rig.terminal.questions import ask, ask_line
from rig.terminal.screen import begin_phase

if TYPE_CHECKING:
    from rig.calibrate.kind import Kind
    from rig.calibrate.result import CalibrationResult

SUMMARIES = {
    "camera": "Calibrate a camera's intrinsics and lens distortion from views of a board.",
    "hand-eye": "Calibrate the pose of the camera: base_T_camera if it is fixed, tcp_T_camera if it is on "
    "the tool.",
    "markers": "Measure the noise of the angle from two markers, on pictures of an object at rest.",
    "tactile": "Calibrate a gel's scale and its map from colour to surface slope, from presses of balls.",
    "gripper": "Calibrate the gripper's opening in mm as a monotone function of its counts, and its "
    "hysteresis.",
    "tcp": "Calibrate the position of a clamped pointed tip in the flange frame, by pivoting it in a small "
    "hole.",
    "sync": "Estimate the time offset and drift between streams that measured the same motion.",
}
"""First line of help by name of the kind. The kinds are imported when one of them is used."""


@dataclass(frozen=True)
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
    def files(self) -> Path:
        """Folder of the calibration files: --out, by default the folder that trials on the bench read."""
        from rig.config.calibrations import calibrations_folder

        return self.out or calibrations_folder(self.bench)


def command_of(kind: "Kind[Any]") -> Callable[..., None]:
    """Return the command of a kind, for typer: its own options, then those of all kinds."""

    def command(context: typer.Context, own: Any, station: StationOptions) -> None:
        if station.source is None:
            results = _collect(kind, context, own, station)
        else:
            results = _solve(kind, context, own, station, station.source)
        _store(results, station)

    command.__annotations__["own"] = kind.options
    command.__name__, command.__doc__ = kind.name, kind.options.__doc__
    return command


def _solve(
    kind: "Kind[Any]", context: typer.Context, own: Any, station: StationOptions, folder: Path
) -> "list[CalibrationResult]":
    from rig.calibrate.kind import Samples
    from rig.config import load_bench

    for name, given in (("watch", station.watch), ("watch-at", station.watch_at)):
        if given:
            raise InputError(f"--{name} is for a calibration on a bench: leave it out with --from {folder}")
    begin_phase(f"calibrating from {folder}")
    bench = load_bench(station.bench) if is_given(context, "bench") else None
    solved = kind.solve(Samples(folder, bench), own)
    return solved if isinstance(solved, list) else [solved]


def _collect(
    kind: "Kind[Any]", context: typer.Context, own: Any, station: StationOptions
) -> "list[CalibrationResult]":
    """Collect the samples on the bench. With --dry-run the command ends with the plan, as in `dry_run`."""
    from rig.bench.operators import ConsoleOperator
    from rig.calibrate.bench import Station
    from rig.config import load_bench
    from rig.config.objects import with_objects
    from rig.config.parts import require_parts
    from rig.live.observer import PictureSender

    config = with_objects(load_bench(station.bench), station.bench)
    require_parts(config, f"rig calibrate {kind.name}")
    title = f"{mark(config.simulated and not config.mixed)}calibrate {kind.name} on bench '{config.name}'"
    say(title)
    with ExitStack() as stack:
        watch = WatchOptions() if station.dry else station
        listeners = stack.enter_context(serve_watch_page(context, watch, title, kind.counted, 0))
        show = stack.enter_context(closing(PictureSender(listeners))) if listeners else None
        person = ConsoleOperator(ask, station.yes, ask_line)
        before = partial(dry_run, config, json=station.json) if station.dry else lambda plan: None
        at = Station(config, station.seed, station.files, person, say, before, show, station.bench)
        return kind.collect(at, own)


def _store(results: "list[CalibrationResult]", options: StationOptions) -> None:
    """Store results; print their verdicts, figures, rejected samples and paths.

    Raises `CalibrationError` at the end if any is refused.
    """
    stored: list[dict[str, Any]] = []
    refused: list[str] = []
    for result in results:
        try:
            stored.append(_store_one(result, options.files))
        except CalibrationError as error:
            if len(results) == 1:
                raise
            refused.append(str(error))
            say(str(error))
    paths = [each[name] for each in stored for name in ("file", "page")]
    print_result(options.json, {"calibrations": stored, "refused": refused}, *paths)
    if refused:
        raise CalibrationError(f"{len(refused)} of {len(results)} calibrations were refused; see their pages")


def _store_one(result: "CalibrationResult", folder: Path) -> dict[str, Any]:
    """Store a result, and return its figures; print the rejected samples before, and its verdict after."""
    from calibration.verdict import counted_reasons
    from rig.calibrate.result import file_result

    for line in counted_reasons(result.rejected):
        say(f"left out {line}")
    stored = file_result(result, folder)
    say(f"{mark(result.simulated)}{result.kind} calibration, {result.about}: {result.assessment}")
    for name, text in result.numbers.items():
        say(f"  {name}: {text}")
    return stored


def load_kind(name: str) -> Any:
    """Import the kinds, and return the command of one."""
    from rig.calibrate.kinds import KINDS

    return as_command(name, command_of(KINDS[name]))


class Calibrations(Group):
    """The group of calibrations."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        others, self.commands = self.commands, {}
        for name, summary in SUMMARIES.items():
            self.announce(name, summary, partial(load_kind, name))
        self.commands |= others


calibrate = Commands(
    cls=Calibrations,
    no_args_is_help=True,
    help="Calibrate cameras, sensors, gripper, tool and clocks; write files with uncertainty and a page.\n\n"
    "Samples are collected on --bench, with a question before each motion, or read with --from FOLDER (the "
    "help of each command describes the folder). Results go to --out, by default calibrations/ beside the "
    "bench file (for a built-in bench, in the current folder), where rig trial and rig record find them.",
)


@calibrate.command()
def board(
    target: Annotated[
        str, typer.Argument(help="Target, in the form of --target of the other commands; or protractor.")
    ] = "charuco:8x6:25:18:DICT_5X5_100",
    out: Annotated[
        Path | None, typer.Option("--out", help="File to write, .svg or .pdf.", callback=file_place)
    ] = None,
    json: JsonOption = False,
) -> None:
    """Draw a target to print at a scale of 100 %, with a bar of 100 mm to check with a ruler.

    Measure one side of a square or marker after printing. If it differs, put the measured length into the
    target's name.

    The protractor has a line every 5 degrees, to turn an object on a sensor by a known angle.

    Examples:
      rig calibrate board protractor --out protractor.pdf
      rig calibrate board charuco:8x6:25:18:DICT_5X5_100 --out board.pdf
      rig calibrate board marker:60:DICT_4X4_50:0 --out marker.svg
    """
    from calibration.store import write_bytes
    from calibration.targets.sheets import sheet_svg
    from rig.calibrate.charts import sheet_pdf

    path = out or Path(f"{target.replace(':', '_')}.svg")
    makers = {".svg": lambda: sheet_svg(target).encode(), ".pdf": lambda: sheet_pdf(target)}
    if path.suffix.lower() not in makers:
        raise InputError(f"--out {path}: give a file ending in .svg or .pdf")
    write_bytes(path, makers[path.suffix.lower()]())
    print_result(json, {"target": target, "file": str(path)}, path)


@calibrate.command()
def compare(
    one: Annotated[Path, typer.Argument(help="Calibration file.")],
    other: Annotated[Path, typer.Argument(help="Calibration file of the same kind to compare with.")],
    json: JsonOption = False,
) -> None:
    """Print how far two calibrations differ, in px over the picture or in mm over the workspace.

    Examples:
      rig calibrate compare calibrations/camera-C1.yaml old/camera-C1.yaml
    """
    from rig.calibrate.kinds import compare_files

    figures = compare_files(one, other)
    print_result(json, figures, *(f"{name}: {value}" for name, value in figures.items()))
