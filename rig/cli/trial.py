"""`rig trial`: lift objects, measure their rotation, and compare it with the markers."""

import time
from dataclasses import dataclass, replace
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from drivers.errors import counted
from rig.cli.common import Exit, emit_json, mark, report_faults, say, trial_jobs
from rig.cli.options import BenchOptions, SessionOptions, WatchOptions
from rig.cli.report import report_after
from rig.cli.results import trial_table
from rig.cli.resuming import (
    agreed,
    bench_of,
    continued,
    dry_run,
    may_be_continued,
    named_again,
    say_done,
    usual_lift_s,
    watched,
)
from rig.declared import option, resumed
from rig.terminal.onlookers import announcing
from rig.terminal.questions import ask
from rig.terminal.screen import begin_phase

if TYPE_CHECKING:
    from rig.bench.plan import Plan
    from rig.experiments.lift_plan import TrialSettings
    from rig.results.summary import TrialSummary
    from rig.sessions.about import Remarks


@dataclass(frozen=True, slots=True)
class TrialOptions:
    lifts: int = option(5, "Accepted lifts per object.", min=1, max=1000, stored="lifts_per_object")
    objects: list[str] | None = option(
        None,
        "Object, by id or name; repeat for more. Default: the nine objects of the paper's trial.",
        "--object",
        stored="objects",
        read=list,
    )
    max_mare: float | None = option(
        None,
        "Exit with code 4 if the MARE (mean absolute error of the angle, phases B and C) is above this, "
        "degrees.",
        min=0.0,
    )
    realtime: bool = option(False, "Run a simulated bench in real time. Default: as fast as possible.")
    jobs: int | None = option(
        None, "Lifts in parallel on a simulated bench. Default: one per core.", min=1, max=64
    )
    live: bool = option(False, "Show images, markers, angles and arm in rerun (extra 'live').")


@dataclass(frozen=True, slots=True)
class EstimatorOptions:
    estimator: str | None = option(
        None,
        "slip, skeleton, ellipse, pca; the last three also with -published; ecc, "
        "kolamuri, anglenet, toskov; or your own, as package.module:Class (rig estimators). Default: slip.",
        stored="estimator",
    )
    window: int | None = option(
        None,
        "Report the mean of the last n angles. Default: 2 for the paper's methods, 1 for others.",
        min=1,
        max=100,
        stored="window",
    )
    no_skip: bool = option(
        False,
        "Run every stage on every frame, also if it could be skipped (the paper's methods always do).",
        stored="skip",
        read=lambda skip: not skip,
    )


@dataclass(frozen=True, slots=True)
class ReactionOptions:
    react: Literal["none", "stop", "tighten", "lower"] = option(
        "none",
        "Reaction to slip: stop the arm; tighten the grip and continue; or lower the object. "
        "On a real bench the bench file must allow it.",
        stored="react",
        read=lambda kind: kind.value,
    )
    alarms_per_hour: float = option(
        10.0,
        "For --react: accepted rate of false slip alarms per hour with a resting object.",
        min=1e-6,
        max=1e5,
        stored="false_alarms_per_hour",
    )
    max_turn_deg: float | None = option(
        None,
        "For --react: react only if the object would otherwise turn by more than this. Default: react to "
        "any slip.",
        min=0.5,
        max=180.0,
        stored="max_turn_deg",
    )


def trial(
    context: typer.Context,
    what: TrialOptions,
    estimator: EstimatorOptions,
    reaction: ReactionOptions,
    bench: BenchOptions,
    session: SessionOptions,
    watch: WatchOptions,
) -> None:
    """Lift each object several times, measure its rotation in the fingers, and compare it with the markers.

    Examples:
      rig trial --lifts 5
      rig trial --lifts 1 --object wrench --object 7 --estimator ellipse
      rig trial --bench my_bench.toml --dry-run
      rig trial --lifts 1 --object toothbrush --react tighten
      rig trial --lifts 3 --objects my_objects --object my_box
      rig trial --lifts 5 --name "new gel" --tag gel-7 --operator Ada
      rig trial --resume --out sessions/campaign
      rig trial --lifts 5 --watch
    """
    from rig.sessions.rows import read_finished_lifts

    lifting = _prepare(context, what, estimator, reaction, bench, session)
    if bench.dry:
        dry_run(lifting.settings.bench, lifting.plan(), session.json)
    summary = _lift_all(context, lifting, bench, session, what.live, watch)
    wall_s = time.perf_counter() - lifting.began
    trial_table(summary, lifting.simulated, wall_s, session.json)
    page = report_after(lifting.folder, session.no_report)
    if session.json:
        figures = {**summary.as_json(), "wall_s": round(wall_s, 2), "report": page}
        emit_json({"session": str(lifting.folder), **figures})
    report_faults(row.estimator_faults for row in read_finished_lifts(lifting.folder) if row.estimator_faults)
    reached, limit = summary.mare.mean_deg if summary.mare else float("inf"), what.max_mare
    if limit is not None and reached > limit:
        say(f"rig: MARE {reached:.2f} degrees is above the limit of {limit:g} degrees (--max-mare)")
        raise typer.Exit(Exit.LIMIT_MISSED)


@dataclass(frozen=True, slots=True)
class _Trial:
    """A trial to begin or to resume.

    began: start of the command on the clock of `perf_counter`, s. done: number of finished lifts. usual_s:
    mean time per finished lift; None if there is none.
    """

    settings: "TrialSettings"
    folder: Path
    objects: list[str]
    lifts: int
    jobs: int
    remarks: "Remarks"
    began: float
    done: int = 0
    usual_s: float | None = None

    @property
    def simulated(self) -> str:
        """Prefix of printed results: "SIMULATED ", or "" on a real bench."""
        return mark(self.settings.bench.simulated)

    @property
    def wanted(self) -> int:
        return len(self.objects) * self.lifts

    def plan(self) -> "Plan":
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
    """Read the bench and the session to resume; return the trial with its settings. Raises `InputError`."""
    from protocols.reaction import ReactionKind
    from rig.config.objects import with_more
    from rig.experiments.lift_plan import TrialSettings, require_reaction
    from rig.experiments.trial import resolve_objects, trial_manifest
    from rig.lift.slip_watch import SlipSettings
    from rig.sessions.manifest import TrialManifest
    from rig.sessions.session import require_same
    from rig.tactile.estimators import choose_estimator

    began, remarks = time.perf_counter(), session.remarks()
    config = bench_of(context, bench, session, "rig trial")
    folder, stored = continued(TrialManifest, "trial", config.name, session)
    if stored is not None:
        config = with_more(config, stored.config.objects)
        named_again(estimator.estimator, stored.estimator)
        what, bench = resumed(what, stored, context), resumed(bench, stored, context)
        estimator, reaction = resumed(estimator, stored, context), resumed(reaction, stored, context)
    choice = choose_estimator(estimator.estimator, estimator.window, not estimator.no_skip)
    slip = SlipSettings(reaction.alarms_per_hour, reaction.max_turn_deg)
    kind = ReactionKind(reaction.react)
    settings = TrialSettings(config, bench.seed, choice, what.realtime, kind, slip)
    objects = resolve_objects(what.objects, config.objects)
    require_reaction(settings, objects)
    jobs = trial_jobs(what.jobs, config.in_process, what.realtime)
    if stored is not None:
        require_same(folder, stored, trial_manifest(settings, objects, what.lifts))
    trial = _Trial(settings, folder, objects, what.lifts, jobs, remarks, began)
    reacting = "" if reaction.react == "none" else f", reaction to slip '{reaction.react}'"
    say(
        f"{trial.simulated}bench '{config.name}', seed {bench.seed}, estimator {choice.name}"
        f"{reacting}, session {folder}"
    )
    at_once = min(jobs, trial.wanted)
    parallel = f", {at_once} at a time" if at_once > 1 else ""
    say(
        f"{counted(trial.wanted, 'lift')} of {counted(len(objects), 'object')}{parallel}; "
        "the remaining time is shown from the first lift on"
    )
    begin_phase(f"preparing estimator {choice.name}")
    choice.try_making()
    if stored is None:
        return trial
    return replace(trial, done=say_done(folder, trial.wanted), usual_s=usual_lift_s(folder, jobs))


def _lift_all(
    context: typer.Context,
    trial: _Trial,
    bench: BenchOptions,
    session: SessionOptions,
    live: bool,
    watch: WatchOptions,
) -> "TrialSummary":
    from rig.bench.operators import ConsoleOperator
    from rig.bench.source import session_bench
    from rig.experiments.trial import run_trial
    from rig.live.session import live_session
    from rig.live.trial_view import TrialView
    from rig.results.notes import lift_note
    from rig.results.summary import summarize_trial
    from rig.sessions.rows import read_lifts
    from rig.terminal.progress import OneMessage

    folder, settings = trial.folder, trial.settings
    config = settings.bench

    def show_partial() -> None:
        summary = summarize_trial(read_lifts(folder))
        say(f"{summary.lifts_accepted} of {counted(trial.wanted, 'lift')} are done")
        if summary.objects:
            trial_table(summary, trial.simulated, time.perf_counter() - trial.began, session.json)

    title = f"{trial.simulated}trial on bench '{config.name}', {folder}"
    question = f"{trial.plan().text()}\nBegin?"
    person = ConsoleOperator(ask, agreed=agreed(context, bench, config))
    person.feeder = config.feeder
    message = OneMessage(lift_note, attrgetter("fault"))
    with (
        may_be_continued(folder, session, show_partial),
        watched(context, watch, title, "lifts", trial.wanted, trial.done) as others,
        session_bench(config, person, question, settings.realtime) as benches,
        live_session(live, others) as (feed, inbox),
        TrialView(trial.wanted, inbox, message, trial.done, trial.usual_s) as view,
    ):
        return run_trial(
            folder,
            settings,
            trial.objects,
            trial.lifts,
            jobs=trial.jobs,
            resume=session.resume,
            benches=benches,
            progress=announcing(view, lift_note, attrgetter("fault")),
            live=feed,
            remarks=trial.remarks,
        )
