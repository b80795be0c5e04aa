"""The `rig` command: registers the subcommands and turns errors into one line and an exit code."""

import os
import sys

import typer

from drivers.errors import RigError
from rig.cli.bench import bench
from rig.cli.benchmark.commands import benchmark
from rig.cli.calibrate.commands import calibrate
from rig.cli.common import exit_code, say, stop_on_signals
from rig.cli.compare import compare
from rig.cli.doctor import doctor
from rig.cli.estimate import estimate
from rig.cli.export import export
from rig.cli.fakes import fakes
from rig.cli.label import label
from rig.cli.model import model
from rig.cli.play import play
from rig.cli.record import record
from rig.cli.replay import replay
from rig.cli.report import report
from rig.cli.results import results
from rig.cli.segment import segment
from rig.cli.sessions import sessions
from rig.cli.train import train
from rig.cli.train_angle import train_angle
from rig.cli.trial import trial

app = typer.Typer(
    name="rig",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode="rich",
    pretty_exceptions_enable=False,
    help="Test rig for measuring how a grasped object turns when it slips, from tactile images.\n\n"
    "Starts on a simulated bench: [bold]rig trial --lifts 1 --object wrench[/bold]",
)
for command in (record, trial, sessions, report, compare, play, export, replay, results):
    app.command()(command)
for command in (estimate, segment, label, train, train_angle, doctor):
    app.command()(command)
app.add_typer(model, name="model")
app.add_typer(bench, name="bench")
app.add_typer(fakes, name="fakes")
app.add_typer(benchmark, name="benchmark")
app.add_typer(calibrate, name="calibrate")


def main() -> None:
    """Run the command line."""
    # Matrices are small here: BLAS threads gain nothing and make a busy computer ten times slower. Read when
    # numpy is imported, which no command is before it runs.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    stop_on_signals()
    try:
        app()
    except RigError as error:
        notes = "".join(f" [{note}]" for note in getattr(error, "__notes__", []))
        say(f"rig: {error}{notes}")
        sys.exit(exit_code(error))
    except BrokenPipeError:
        sys.exit(0)
