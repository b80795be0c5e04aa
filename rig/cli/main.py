"""The `rig` command: registers the subcommands and turns errors into one line and an exit code."""

import os
import signal
import sys
from contextlib import suppress
from typing import Annotated

import typer

from drivers.errors import InputError, OperatorStopError, RigError
from rig.cli.benchmark import Program, benchmark
from rig.cli.calibrate import calibrate
from rig.cli.common import STOPS, Exit, begin_answer, emit_error, say, stop_on_signals
from rig.cli.compare import compare
from rig.cli.doctor import doctor
from rig.cli.estimate import estimate, explain
from rig.cli.export import export
from rig.cli.fakes import fakes
from rig.cli.helping import Commands
from rig.cli.label_angle import label_angle
from rig.cli.live import bridge, live
from rig.cli.own_files import bench, new, objects
from rig.cli.play import play
from rig.cli.record import record
from rig.cli.replay import replay
from rig.cli.report import report
from rig.cli.results import results
from rig.cli.segment import label, segment
from rig.cli.sessions import sessions
from rig.cli.teach import teach
from rig.cli.train import estimators, model, train, train_angle, train_turning
from rig.cli.trial import trial
from rig.terminal.screen import Output, begin_phase, guarded_output, plain
from rig.version import version_text

app = Commands(
    name="rig",
    cls=Program,
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="Test rig for measuring how a grasped object turns when it slips, from tactile images.\n\n"
    "Starts on a simulated bench: rig trial --lifts 1 --object wrench",
)


def _version(asked: bool) -> None:
    if asked:
        print(f"rig {version_text()}")
        raise typer.Exit


@app.callback()
def _program(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    del version


COMMANDS = {
    "Run": (trial, record, replay, teach),
    "Results": (sessions, report, play, compare, results, export),
    "Own images": (live, estimate, explain, segment, label, label_angle),
    "Bench": (doctor,),
    "Advanced": (estimators, new, train, train_angle, train_turning),
}
"""Commands by the title of their group in `rig --help`."""
for title, group in COMMANDS.items():
    for command in group:
        app.command(rich_help_panel=title)(command)
app.add_typer(bridge, name="bridge", rich_help_panel="Own images")
app.add_typer(bench, name="bench", rich_help_panel="Bench")
app.add_typer(objects, name="objects", rich_help_panel="Bench")
app.add_typer(fakes, name="fakes", rich_help_panel="Bench")
app.add_typer(calibrate, name="calibrate", rich_help_panel="Calibrate")
app.add_typer(benchmark, name="benchmark", rich_help_panel="Advanced")
app.add_typer(model, name="model", rich_help_panel="Advanced")


def main() -> None:
    """Run the command line. A signal that comes while the first one is answered ends the program here."""
    # The matrices are small: BLAS threads gain nothing, and a loaded host becomes ten times slower with them.
    # numpy reads this variable when it is imported, and commands import numpy only when they run.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Errors of images are printed by the rig; OpenCV must not print its own as well.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    try:
        _run_and_report()
    except OperatorStopError:
        _ignore_stops()
        sys.exit(Exit.STOPPED)


def _run_and_report() -> None:
    """Run the command; end with one line and an exit code if it fails. Signals raise errors from here on."""
    try:
        stop_on_signals()
        begin_answer()
        with guarded_output() as printed:
            if "_RIG_COMPLETE" not in os.environ:  # the shell's completion, which shows stderr
                begin_phase("loading")
            _run(printed)
    except RigError as error:
        notes = "".join(f" [{note}]" for note in getattr(error, "__notes__", []))
        code = Exit.USAGE if isinstance(error, InputError) else Exit.FAULT
        if isinstance(error, OperatorStopError):
            code = Exit.STOPPED
        _end(f"{error}{notes}", type(error).__name__, code)
    except OSError as error:  # an access to a file that has no error handling of its own
        _end(f"{error.filename or 'a file'}: {error.strerror or error}", "OSError", Exit.FAULT)


def _run(printed: Output) -> None:
    """Run the command that was typed; with --json print usage errors of typer as a JSON object, too."""
    try:
        app()
    except SystemExit as end:
        if isinstance(end.code, int) and end.code != 0:
            # the text inside the frame in which typer prints a usage error; without a frame the last line
            tail = printed.tail()
            framed = [line.strip("│ ") for line in tail.splitlines() if line.startswith("│")]
            emit_error(" ".join(framed or tail.strip().splitlines()[-1:]), "UsageError", end.code)
        _ignore_stops()
        raise


def _end(message: str, kind: str, code: Exit) -> None:
    """Print the error as one line without control characters or passwords, and exit."""
    from drivers.formats import without_passwords

    _ignore_stops()
    with suppress(OSError, ValueError):
        text = " ".join(plain(without_passwords(message)).splitlines())
        say(f"rig: {text}")
        emit_error(text, kind, code)
    sys.exit(code)


def _ignore_stops() -> None:
    """Ignore any further Ctrl-C when the work is done, so that it cannot change the exit code."""
    for number in (*STOPS, signal.SIGHUP, signal.SIGALRM):
        signal.signal(number, signal.SIG_IGN)
