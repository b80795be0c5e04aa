"""`rig trial`: lift objects, measure how they turn, compare with the markers."""

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from drivers.errors import counted
from rig.cli.common import Exit, ask, emit_json, say, trial_jobs
from rig.cli.declared import resumed, stored_as
from rig.cli.dry_run import dry_run
from rig.cli.options import BenchOptions, SessionOptions, WatchOptions
from rig.cli.places import file_place
from rig.cli.report import report_after
from rig.cli.resuming import continued, may_be_continued, named_again, say_done, usual_lift_s
from rig.cli.watching import Work, telling, watched

if TYPE_CHECKING:
    from rig.config import BenchConfig
    from rig.experiments.lift_plan import TrialSettings
    from rig.results.summary import TrialSummary
    from rig.sessions.remarks import Remarks


@dataclass(frozen=True, slots=True)
class TrialOptions:
    """The objects, the number of lifts, and the limit on the result."""

    lifts: Annotated[int, typer.Option("--lifts", min=1, max=1000, help="Accepted lifts per object.")] = (
        stored_as("lifts_per_object", 5)
    )
    objects: Annotated[
        list[str] | None,
        typer.Option("--object", help="Object id or name; repeat for more. Default: the trial's nine."),
    ] = stored_as("objects", None, list)
    max_mare: Annotated[
        float | None,
        typer.Option("--max-mare", min=0.0, help="Exit 4 when the MARE over B and C is above, degrees."),
    ] = None
    realtime: Annotated[bool, typer.Option("--realtime", help="Pace a simulated bench by the clock.")] = False
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", min=1, max=64, help="Simulated lifts side by side; default: cores."),
    ] = None


@dataclass(frozen=True, slots=True)
class EstimatorOptions:
    """The estimator that is used online."""

    estimator: Annotated[
        str | None,
        typer.Option(
            "--estimator",
            help="slip (default), skeleton, ellipse, pca; these three also with -published; ecc, polar, "
            "kolamuri, anglenet, toskov; or your own, as package.module:Class (rig estimators).",
        ),
    ] = stored_as("estimator", None)
    window: Annotated[
        int | None,
        typer.Option(
            "--window",
            min=1,
            max=100,
            help="Mean of the last n angles; 2 for the paper's methods, none for slip.",
        ),
    ] = stored_as("window", None)
    no_skip: Annotated[
        bool,
        typer.Option(
            "--no-skip", help="Run every stage on every frame, needed or not (the paper's methods always do)."
        ),
    ] = stored_as("skip", False, lambda skip: not skip)


@dataclass(frozen=True, slots=True)
class ReactionOptions:
    """The reaction to slip."""

    react: Annotated[
        Literal["none", "stop", "tighten", "lower"],
        typer.Option(
            "--react",
            help="On slip: stop the arm; tighten the grip, then lift on; or lower the object. "
            "A real bench's file has to allow it.",
        ),
    ] = stored_as("react", "none", lambda kind: kind.value)
    false_alarms_per_hour: Annotated[
        float,
        typer.Option(
            "--false-alarms-per-hour",
            min=1e-6,
            max=1e5,
            help="How often a resting object may count as slipping, for --react.",
        ),
    ] = stored_as("false_alarms_per_hour", 10.0)
    max_turn_deg: Annotated[
        float | None,
        typer.Option(
            "--max-turn-deg",
            min=0.5,
            max=180.0,
            help="React only when the object would else turn by more; without it at once.",
        ),
    ] = stored_as("max_turn_deg", None)


@dataclass(frozen=True, slots=True)
class RerunOptions:
    """The viewer rerun."""

    live: Annotated[
        bool, typer.Option("--live", help="Open rerun: pictures, markers, angles, arm (extra 'live').")
    ] = False
    live_to: Annotated[
        Path | None,
        typer.Option("--live-to", help="The same into FILE.rrd, without a display.", callback=file_place),
    ] = None


def trial(
    context: typer.Context,
    what: TrialOptions,
    estimator: EstimatorOptions,
    reaction: ReactionOptions,
    bench: BenchOptions,
    session: SessionOptions,
    rerun: RerunOptions,
    watch: WatchOptions,
) -> None:
    """Lift each object several times and measure its rotation from both fingertips.

    Examples:
      rig trial --lifts 5

      rig trial --lifts 1 --object wrench --object 7 --estimator ellipse

      rig trial --bench my_bench.toml --dry-run

      rig trial --lifts 1 --object toothbrush --react tighten

      rig trial --lifts 3 --objects my_objects --object my_box

      rig trial --lifts 5 --name "new gel" --tag gel-7 --operator Ada

      rig trial --resume

      rig trial --resume --out sessions/campaign

      rig trial --bench wire --lifts 1 --object wrench --live-to wrench.rrd

      rig trial --lifts 5 --watch --notify notify-send

    """
    lifting = _prepare(context, what, estimator, reaction, bench, session)
    if bench.dry:
        dry_run(lifting.bench, lifting.plan(), session.json)
    _lift_all(context, lifting, session, rerun, watch, agreed=bench.yes)


@dataclass(frozen=True, slots=True)
class _Trial:
    """A trial to begin or to resume. began: when the command did. usual_s: mean time per lift so far."""

    settings: "TrialSettings"
    folder: Path
    objects: list[str]
    lifts: int
    jobs: int
    max_mare: float | None
    remarks: "Remarks"
    began: float
    done: int = 0
    usual_s: float | None = None

    @property
    def bench(self) -> "BenchConfig":
        """The bench."""
        return self.settings.bench

    @property
    def simulated(self) -> str:
        """The mark of simulated results; "" on a real bench."""
        return "SIMULATED " if self.bench.simulated else ""

    @property
    def wanted(self) -> int:
        """Number of lifts that were asked for."""
        return len(self.objects) * self.lifts

    def plan(self) -> Any:
        """Return the plan that is shown before anything moves. Raises `InputError`."""
        from rig.experiments.trial import trial_plan

        return trial_plan(self.settings, self.objects, self.lifts)


def _prepare(
    context: typer.Context,
    what: TrialOptions,
    estimator: EstimatorOptions,
    reaction: ReactionOptions,
    bench: BenchOptions,
    session: SessionOptions,
) -> _Trial:
    """Read the bench and the session to resume, and make the settings. Raises `InputError`."""
    from rig.config.calibrations import load_calibrated_bench
    from rig.config.objects import with_more, with_objects
    from rig.experiments.reactions import require_reaction
    from rig.experiments.trial import resolve_objects
    from rig.sessions.manifest import TrialManifest
    from rig.sessions.remarks import remarks_of

    began = time.perf_counter()
    remarks = remarks_of(session.name, session.note, session.tags, session.operator)
    config = with_objects(load_calibrated_bench(bench.bench, say), bench.bench, bench.own_objects)
    folder, stored = continued(TrialManifest, "trial", config.name, session.out, session.resume)
    if stored is not None:
        config = with_more(config, stored.config.objects)
        named_again(estimator.estimator, stored.estimator)
        what, bench = resumed(what, stored, context), resumed(bench, stored, context)
        estimator, reaction = resumed(estimator, stored, context), resumed(reaction, stored, context)
    settings = _settings(config, what, estimator, reaction, bench.seed)
    objects = resolve_objects(what.objects, config.objects)
    require_reaction(settings, objects)
    trial = _Trial(
        settings=settings,
        folder=folder,
        objects=objects,
        lifts=what.lifts,
        jobs=trial_jobs(what.jobs, config.in_process, what.realtime),
        max_mare=what.max_mare,
        remarks=remarks,
        began=began,
    )
    reacting = "" if reaction.react == "none" else f", reaction to slip '{reaction.react}'"
    say(
        f"{trial.simulated}bench '{config.name}', seed {bench.seed}, estimator {settings.estimator.name}"
        f"{reacting}, session {folder}"
    )
    if stored is None:
        return trial
    return replace(trial, done=say_done(folder, trial.wanted), usual_s=usual_lift_s(folder, trial.jobs))


def _settings(
    config: "BenchConfig",
    what: TrialOptions,
    estimator: EstimatorOptions,
    reaction: ReactionOptions,
    seed: int,
) -> "TrialSettings":
    from protocols.reaction import ReactionKind
    from rig.experiments.lift_plan import TrialSettings
    from rig.lift.slip_watch import SlipSettings
    from rig.live.screen import begin_phase
    from rig.tactile.estimators import choose_estimator

    choice = choose_estimator(estimator.estimator, estimator.window, not estimator.no_skip)
    begin_phase(f"preparing estimator {choice.name}")
    choice.try_making()
    slip = SlipSettings(reaction.false_alarms_per_hour, reaction.max_turn_deg)
    return TrialSettings(config, seed, choice, what.realtime, ReactionKind(reaction.react), slip)


def _lift_all(
    context: typer.Context,
    trial: _Trial,
    session: SessionOptions,
    rerun: RerunOptions,
    watch: WatchOptions,
    agreed: bool,
) -> None:
    """Carry out the lifts that are missing, and print, report and check the results."""
    from rig.bench.operators import ConsoleOperator
    from rig.bench.source import session_bench
    from rig.cli.printing import OneMessage, lift_fault, lift_note, summary_json, trial_table
    from rig.experiments.trial import run_trial
    from rig.live.session import live_session
    from rig.live.terminal import TrialView

    folder, realtime, plan = trial.folder, trial.settings.realtime, trial.plan()
    person = ConsoleOperator(ask, agreed=agreed)
    work = Work(
        f"{trial.simulated}trial on bench '{trial.bench.name}', {folder}", "lifts", trial.wanted, trial.done
    )
    message = OneMessage(lift_note, lift_fault)
    with (
        may_be_continued(
            folder,
            session.out,
            session.resume,
            session.no_report,
            lambda: _print_partial(trial, session.json),
        ),
        watched(context, work, watch) as others,
        session_bench(trial.bench, person, f"{plan.text()}\nBegin?", realtime) as benches,
        live_session(rerun.live, rerun.live_to, others) as (feed, inbox),
        TrialView(trial.wanted, inbox, message, trial.done, trial.usual_s) as progress,
    ):
        summary = run_trial(
            folder,
            trial.settings,
            trial.objects,
            trial.lifts,
            jobs=trial.jobs,
            resume=session.resume,
            benches=benches,
            progress=telling(progress, lift_note, lift_fault),
            live=feed,
            remarks=trial.remarks,
        )
    wall_s = time.perf_counter() - trial.began
    trial_table(summary, trial.simulated, wall_s, to_stderr=session.json)
    page = report_after(folder, session.no_report)
    if session.json:
        figures = {**summary_json(summary), "wall_s": round(wall_s, 2), "report": page}
        emit_json({"session": str(folder), **figures})
    _check_limit(summary, trial.max_mare)


def _print_partial(trial: _Trial, json: bool) -> None:
    """Print the table of the finished lifts when a trial ends early."""
    from rig.cli.printing import trial_table
    from rig.results.summary import summarize_trial
    from rig.sessions.rows import read_lifts

    summary = summarize_trial(read_lifts(trial.folder))
    say(f"{summary.lifts_accepted} of {counted(trial.wanted, 'lift')} are done")
    if summary.objects:
        trial_table(summary, trial.simulated, time.perf_counter() - trial.began, to_stderr=json)


def _check_limit(summary: "TrialSummary", max_mare: float | None) -> None:
    if max_mare is None:
        return
    reached = summary.mare.mean_deg if summary.mare else float("inf")
    if reached > max_mare:
        say(f"rig: MARE {reached:.2f} degrees is above the limit of {max_mare:g} given with --max-mare")
        raise typer.Exit(Exit.LIMIT_MISSED)
