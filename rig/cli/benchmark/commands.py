"""`rig benchmark`: what the rig does, measured, as tables."""

from typing import Any

from rig.cli.benchmark.calibration import calibration
from rig.cli.benchmark.clips import clips
from rig.cli.benchmark.endurance import endurance
from rig.cli.benchmark.estimators import estimators
from rig.cli.benchmark.faults import faults
from rig.cli.benchmark.others import others
from rig.cli.benchmark.reaction import reaction
from rig.cli.benchmark.renderer import renderer
from rig.cli.benchmark.safety import safety
from rig.cli.benchmark.seeds import seeds
from rig.cli.benchmark.segmentation import segmentation
from rig.cli.benchmark.trials import trials
from rig.cli.benchmark.wire import wire
from rig.cli.helping import Commands, Group


class EstimatorsByDefault(Group):
    """`rig benchmark` is `rig benchmark estimators`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put the default subcommand in front of options, and where there is nothing."""
        if not ctx.resilient_parsing and (not args or (args[0].startswith("-") and args[0] != "--help")):
            args = ["estimators", *args]
        return super().parse_args(ctx, args)


benchmark = Commands(
    cls=EstimatorsByDefault,
    help="Measure what the rig does, and print it as tables. Without a command: estimators.",
)


benchmark.command("estimators")(estimators)
benchmark.command("wire")(wire)
benchmark.command("faults")(faults)
benchmark.command("safety")(safety)
benchmark.command("endurance")(endurance)
benchmark.command("calibration")(calibration)
benchmark.command("segmentation")(segmentation)
benchmark.command("trials")(trials)
benchmark.command("clips")(clips)
benchmark.command("renderer")(renderer)
benchmark.command("seeds")(seeds)
benchmark.command("reaction")(reaction)
benchmark.command("others")(others)
