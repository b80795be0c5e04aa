"""`rig benchmark reaction`: what a reaction to slip is worth."""

from typing import Annotated, Literal

import typer

from rig.cli.benchmark.missed import exit_where_missed
from rig.cli.benchmark.tables import print_tables
from rig.cli.common import JobsOption, JsonOption, SeedOption, emit_json


def reaction(
    react: Annotated[
        Literal["stop", "tighten", "lower"], typer.Option("--react", help="What is done on a slip.")
    ] = "tighten",
    objects: Annotated[
        list[str] | None,
        typer.Option("--object", help="By id or name; repeat. Default: the trial's nine."),
    ] = None,
    lifts: Annotated[int, typer.Option("--lifts", min=1, max=100, help="Of each object.")] = 5,
    false_alarms_per_hour: Annotated[
        float, typer.Option("--false-alarms-per-hour", help="Reactions at rest that are accepted.")
    ] = 10.0,
    max_turn_deg: Annotated[
        float | None,
        typer.Option("--max-turn-deg", min=0.5, max=90.0, help="React when it would turn further."),
    ] = None,
    wire_lifts: Annotated[
        int,
        typer.Option("--wire-lifts", min=0, max=100, help="Further lifts behind wires, in real time."),
    ] = 4,
    full: Annotated[
        bool, typer.Option("--full", help="Also lifts that hold, two hours at rest, faults in a reaction.")
    ] = False,
    jobs: JobsOption = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Lift the same SIMULATED objects without and with a reaction to slip, and compare.

    What was caught, how far the objects turned, how long a slip took to be told, false reactions, fallen and
    damaged objects. What truly happened is asked of the simulated world. A few more lifts run in real time,
    behind wires: how soon a command follows its frame. Exit code 4 when a limit was missed.

    Examples:
      rig benchmark reaction

      rig benchmark reaction --full

      rig benchmark reaction --react stop --object wrench --lifts 3 --json

    """
    from protocols.reaction import ReactionKind
    from rig.benchmark.estimators.tables import limit_table
    from rig.benchmark.reaction.benchmark import as_json, reaction_table, run_reaction
    from rig.benchmark.reaction.lifts import as_late_as_real
    from rig.cli.printing import WorkProgress
    from rig.config import load_bench
    from rig.experiments.lift_attempt import TrialSettings
    from rig.experiments.trial import resolve_objects
    from rig.lift.slip_watch import SlipSettings
    from rig.tactile.estimators import choose_estimator

    slip = SlipSettings(false_alarms_per_hour, max_turn_deg)
    bench = as_late_as_real(load_bench("fake"))
    settings = TrialSettings(bench, seed, choose_estimator("slip"), react=ReactionKind(react), slip=slip)
    with WorkProgress(0, "lifts") as progress:
        ids = resolve_objects(objects, bench.objects)
        result = run_reaction(settings, ids, lifts, jobs, progress.show, wire_lifts, full)
    print_tables((reaction_table(result), limit_table(result.limits, f"'{react}'")), json, result.wall_s)
    if json:
        emit_json(as_json(result))
    exit_where_missed(result.limits)
