"""The `rig` command: lists the subcommands and turns errors into a message and an exit code."""

import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from importlib import import_module
from typing import Annotated, Any

import typer

from drivers.errors import FileFaultsError, InputError, OperatorStopError, RigError, without_passwords
from rig.cli.common import STOPS, Exit, begin_answer, emit_error, say, stop_on_signals
from rig.cli.helping import Commands, Group, as_command
from rig.terminal.screen import Output, begin_phase, guarded_output, plain
from rig.version import version_text

COMMANDS = {
    "Run": {
        "trial": "Lift each object several times, measure its rotation in the fingers, and compare it with "
        "the markers.",
        "record": "Grasp one object in all poses of its file with varied grip, and store the tactile images.",
        "replay": "Estimate the lifts of sessions again from the stored frames.",
        "teach": "Teach where an object is grasped, its width there, and the height of the lift.",
    },
    "Results": {
        "sessions": "List sessions with date, objects, estimator, MARE, limits, contact area and size; "
        "report broken ones.",
        "report": "Write the report of a session as one HTML page without external files.",
        "play": "Make a film of a lift or of your own frames, with contact, axes and the angle over time.",
        "compare": "Compare two trials, or two estimators on one trial, by paired differences with "
        "intervals.",
        "export": "Export a session to a format that other tools open. The session itself is not changed.",
    },
    "Own images": {
        "live": "Show the angle of one or two tactile sensors live, in the browser, as text or as JSON.",
        "show": "Show a stored clip, ROS bag or lift as a whole, on a page with a slider.",
        "estimate": "Estimate the rotation of the contact in tactile images, in a table with a row per "
        "frame.",
        "explain": "Draw how the estimator slip finds an angle, on the two frames with the largest "
        "rotation between them.",
        "segment": "Write a contact mask STEM.png for every image, of the same size, with values 0 and 255.",
        "label": "Propose a LabelMe polygon around the contact of each image, and export all labels.",
        "label-angle": "Label the rotation of an object in a clip, by a line on each frame that two clicks "
        "draw.",
        "bridge": "Publish live angles, alarms and images for other robot software.",
    },
    "Bench": {
        "doctor": "Check every device of a bench and this computer. Nothing moves.",
        "bench": "Write a bench file, which describes the devices of a bench.",
        "objects": "List the objects that can be grasped; write an object file of your own.",
        "fakes": "Serve simulated devices over the wire protocols of the real ones, in one simulated world.",
    },
    "Advanced": {
        "estimators": "List the available estimators: the rig's own and those of installed packages.",
        "new": "Write a template package of your own estimator, sensor, camera, arm and gripper, which "
        "runs unchanged.",
        "train": "Train segmentation networks for the contact, test them on other objects, and export them "
        "to ONNX.",
        "benchmark": "Measure the rig, and print the results as tables. Without a command: estimators.",
        "model": "List the networks of the rig; import a checkpoint of your own.",
    },
    "Calibrate": {
        "calibrate": "Calibrate cameras, sensors, gripper, tool and clocks; write files with uncertainty "
        "and a page.",
    },
}
"""First line of help of each command, by the title of its group in `rig --help`.

The command NAME is `NAME` in `rig.cli.NAME` or in the module of `MODULES`; it is imported when it is used.
"""
MODULES = {
    "explain": "estimate", "label": "segment", "bridge": "live", "bench": "own_files", "objects": "own_files",
    "new": "own_files", "estimators": "train", "model": "train",
}  # fmt: skip


class Program(Group):
    """The commands of `rig`."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for title, group in COMMANDS.items():
            for name, summary in group.items():
                self.announce(name, summary, partial(_load, name), title)


def _load(name: str) -> Any:
    """Import and return a command of `COMMANDS`."""
    variable = name.replace("-", "_")
    module = import_module(f"rig.cli.{MODULES.get(variable, variable)}")
    return as_command(name, getattr(module, variable))


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
    """Run the command; end with a message and an exit code if it fails. Signals raise errors from here on."""
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
        lines = error.lines if isinstance(error, FileFaultsError) else (f"{error}{notes}",)
        _end(lines, type(error).__name__, code)
    except ModuleNotFoundError as error:
        from rig.config.extras import WIRE, pip_line

        module = str(error.name).partition(".")[0]
        if module not in WIRE:
            raise
        _end((f"this bench needs {module}: {pip_line(WIRE[module])}",), "InputError", Exit.USAGE)
    except OSError as error:  # an access to a file that has no error handling of its own
        _end((f"{error.filename or 'a file'}: {error.strerror or error}",), "OSError", Exit.FAULT)


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


def _end(lines: Sequence[str], kind: str, code: Exit) -> None:
    """Print the lines of an error without control characters or passwords, and exit."""
    _ignore_stops()
    with suppress(OSError, ValueError):
        text = "\n".join(" ".join(plain(without_passwords(line)).splitlines()) for line in lines)
        say(f"rig: {text}")
        emit_error(text, kind, code)
    sys.exit(code)


def _ignore_stops() -> None:
    """Ignore any further Ctrl-C when the work is done, so that it cannot change the exit code."""
    for number in (*STOPS, signal.SIGHUP, signal.SIGALRM):
        signal.signal(number, signal.SIG_IGN)
