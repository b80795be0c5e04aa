"""`rig benchmark`: measure the rig, and print the results as tables."""

from importlib import import_module
from typing import Any

from typer.core import TyperCommand
from typer.main import get_command

from rig.cli.benchmark.studies import command_of
from rig.cli.helping import Commands, Group

STUDIES = {
    "estimators": "Measure run time and error of every estimator, on 45 lifts and on disturbed clips.",
    "clips": "Compare the angles of estimators with the labels of clips, real or simulated.",
    "calibration": "Compare the errors of the calibrations with their limits, on simulated and real data.",
    "reaction": "Lift the same SIMULATED objects without and with a reaction to slip, and compare.",
    "renderer": "Score estimators on SIMULATED lifts of a second renderer, independent of the bench's.",
    "seeds": "Carry out SIMULATED trials of several seeds; print errors and confidently wrong angles.",
    "slip": "Print time, accuracy and size of slip beside their limits, in 10 minutes on two idle cores.",
    "segmentation": "Score the segmentation networks on SIMULATED objects and on real frames.",
    "wire": "Do one lift over the wire protocols in real time; measure lost frames, rates and agreement.",
    "faults": "Let each device fail during a lift over the wire protocols; print how the rig recovers.",
    "safety": "Stop, kill or break a lift at random moments; print how the arm comes to rest.",
    "endurance": (
        "Hold an object still over the wire protocols, in real time, and print the measurements per minute."
    ),
    "trials": "Score networks, angle methods, windows and the paper's rivals on the same SIMULATED lifts.",
}
"""First line of help by name."""
MODULES = {
    "seeds": "rig.benchmark.seeds",
    "wire": "rig.benchmark.wire.lift",
    "faults": "rig.benchmark.wire.faults",
    "safety": "rig.benchmark.wire.safety",
    "endurance": "rig.benchmark.wire.endurance",
}
"""Modules of the studies that are not in `rig.benchmark.NAME.study`; imported on use, because it is slow."""


FIT_SLIP = "fit-slip"


def study_command(name: str, module: str) -> Any:
    """Return the command of a study. module: in which it is."""
    alone = Commands(add_completion=False)
    alone.command(name)(command_of(import_module(module).STUDY))
    return get_command(alone)


class Program(Group):
    """The commands of `rig`; `fit-slip` is a study, which is imported on use."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands[FIT_SLIP] = TyperCommand(
            FIT_SLIP, help="Fit the parameters of slip by maximum likelihood.", rich_help_panel="Advanced"
        )

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command; import the study of `fit-slip`."""
        if cmd_name != FIT_SLIP or self.listing:
            return super().get_command(ctx, cmd_name)
        return study_command(FIT_SLIP, "rig.benchmark.slip_fit.study")


class Benchmarks(Group):
    """The group of benchmarks; `rig benchmark` alone runs `rig benchmark estimators`."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        for name, summary in STUDIES.items():
            self.commands[name] = TyperCommand(name, help=summary)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command; import the study that it belongs to."""
        if cmd_name not in STUDIES or self.listing:
            return super().get_command(ctx, cmd_name)
        return study_command(cmd_name, MODULES.get(cmd_name, f"rig.benchmark.{cmd_name}.study"))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Insert the default subcommand if none is given."""
        if not ctx.resilient_parsing and (not args or (args[0].startswith("-") and args[0] != "--help")):
            args = ["estimators", *args]
        return super().parse_args(ctx, args)


benchmark = Commands(
    cls=Benchmarks,
    help="Measure the rig, and print the results as tables. Without a command: estimators.",
)


@benchmark.callback()
def _group() -> None:
    """Make typer keep the group, which registers no commands: `Benchmarks` imports them on use."""
