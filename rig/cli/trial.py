"""`rig trial`: lift objects, measure how they turn, compare with the markers."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from drivers.errors import counted
from rig.cli.common import (
    BenchOption,
    Exit,
    JsonOption,
    NameOption,
    NoteOption,
    ObjectsOption,
    OperatorOption,
    OutOption,
    ResumeStoredOption,
    SeedOption,
    TagOption,
    YesOption,
    ask,
    emit_json,
    say,
    trial_jobs,
)
from rig.cli.dry_run import DryRunOption, dry_run
from rig.cli.places import file_place
from rig.cli.report import NoReportOption, report_after
from rig.cli.resuming import continued, given, may_be_continued, named_again, say_done, usual_lift_s
from rig.cli.watching import NotifyOption, WatchAtOption, WatchOption, Work, telling, watched


def trial(
    context: typer.Context,
    lifts: Annotated[int, typer.Option("--lifts", min=1, max=1000, help="Accepted lifts per object.")] = 5,
    objects: Annotated[
        list[str] | None,
        typer.Option("--object", help="Object id or name; repeat for more. Default: the trial's nine."),
    ] = None,
    estimator: Annotated[
        str | None,
        typer.Option(
            "--estimator",
            help="slip (default), skeleton, ellipse, pca; these three also with -published; ecc, polar, "
            "kolamuri, anglenet, toskov; or your own, as package.module:Class (rig estimators).",
        ),
    ] = None,
    window: Annotated[
        int | None,
        typer.Option(
            "--window",
            min=1,
            max=100,
            help="Mean of the last n angles; 2 for the paper's methods, none for slip.",
        ),
    ] = None,
    max_mare: Annotated[
        float | None,
        typer.Option("--max-mare", min=0.0, help="Exit 4 when the MARE over B and C is above, degrees."),
    ] = None,
    react: Annotated[
        Literal["none", "stop", "tighten", "lower"],
        typer.Option(
            "--react",
            help="On slip: stop the arm; tighten the grip, then lift on; or lower the object. "
            "A real bench's file has to allow it.",
        ),
    ] = "none",
    false_alarms_per_hour: Annotated[
        float,
        typer.Option(
            "--false-alarms-per-hour",
            min=1e-6,
            max=1e5,
            help="How often a resting object may count as slipping, for --react.",
        ),
    ] = 10.0,
    max_turn_deg: Annotated[
        float | None,
        typer.Option(
            "--max-turn-deg",
            min=0.5,
            max=180.0,
            help="React only when the object would else turn by more; without it at once.",
        ),
    ] = None,
    no_skip: Annotated[
        bool,
        typer.Option(
            "--no-skip", help="Run every stage on every frame, needed or not (the paper's methods always do)."
        ),
    ] = False,
    realtime: Annotated[
        bool, typer.Option("--realtime", help="Pace a simulated bench by the clock.")
    ] = False,
    jobs: Annotated[
        int | None,
        typer.Option("--jobs", min=1, max=64, help="Simulated lifts side by side; default: cores."),
    ] = None,
    own_objects: ObjectsOption = None,
    seed: SeedOption = 0,
    bench: BenchOption = "fake",
    name: NameOption = None,
    note: NoteOption = None,
    tags: TagOption = None,
    operator: OperatorOption = None,
    out: OutOption = None,
    resume: ResumeStoredOption = False,
    no_report: NoReportOption = False,
    dry: DryRunOption = False,
    yes: YesOption = False,
    json: JsonOption = False,
    live: Annotated[
        bool, typer.Option("--live", help="Open rerun: pictures, markers, angles, arm (extra 'live').")
    ] = False,
    live_to: Annotated[
        Path | None,
        typer.Option("--live-to", help="The same into FILE.rrd, without a display.", callback=file_place),
    ] = None,
    watch: WatchOption = False,
    watch_at: WatchAtOption = None,
    notify: NotifyOption = None,
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
    import time

    from protocols.reaction import ReactionKind
    from rig.bench.operators import ConsoleOperator
    from rig.bench.source import session_bench
    from rig.cli.printing import OneMessage, lift_fault, lift_note, summary_json, trial_table
    from rig.config.calibrations import load_calibrated_bench
    from rig.config.objects import with_more, with_objects
    from rig.experiments.lift_attempt import TrialSettings
    from rig.experiments.reactions import require_reaction
    from rig.experiments.trial import resolve_objects, run_trial, trial_plan
    from rig.lift.slip_watch import SlipSettings
    from rig.live.phases import begin_phase
    from rig.live.session import live_session
    from rig.live.terminal import TrialView
    from rig.sessions.manifest import TrialManifest
    from rig.sessions.remarks import remarks_of
    from rig.tactile.estimators import choose_estimator

    began = time.perf_counter()
    remarks = remarks_of(name, note, tags, operator)
    config = with_objects(load_calibrated_bench(bench, say), bench, own_objects)
    folder, stored = continued(TrialManifest, "trial", config.name, out, resume)
    if stored is not None:
        config = with_more(config, stored.config.objects)
        lifts = lifts if given(context, "lifts") else stored.lifts_per_object
        objects = objects or list(stored.objects)
        estimator, window = named_again(estimator, stored.estimator), window or stored.window
        no_skip = no_skip or not stored.skip
        seed = seed if given(context, "seed") else stored.seed
        react = react if given(context, "react") else stored.react.value
        if not given(context, "false_alarms_per_hour"):
            false_alarms_per_hour = stored.false_alarms_per_hour
        max_turn_deg = max_turn_deg or stored.max_turn_deg
    choice = choose_estimator(estimator, window, not no_skip)
    begin_phase(f"preparing estimator {choice.name}")
    choice.try_making()
    slip = SlipSettings(false_alarms_per_hour, max_turn_deg)
    settings = TrialSettings(config, seed, choice, realtime, ReactionKind(react), slip)
    ids = resolve_objects(objects, config.objects)
    require_reaction(settings, ids)
    simulated = "SIMULATED " if config.simulated else ""
    told = "" if react == "none" else f", reaction to slip '{react}'"
    say(f"{simulated}bench '{config.name}', seed {seed}, estimator {choice.name}{told}, session {folder}")
    jobs = trial_jobs(jobs, config.in_process, realtime)
    lifts_done = say_done(folder, len(ids) * lifts) if stored else 0
    usual_s = usual_lift_s(folder, jobs) if stored else None
    plan = trial_plan(settings, ids, lifts)
    if dry:
        dry_run(config, plan, json)
    person = ConsoleOperator(ask, agreed=yes)
    work = Work(f"{simulated}trial on bench '{config.name}', {folder}", "lifts", len(ids) * lifts, lifts_done)
    with (
        may_be_continued(
            folder, out, resume, no_report, lambda: _partial(folder, len(ids) * lifts, simulated, began, json)
        ),
        watched(context, work, watch, watch_at, notify) as others,
        session_bench(config, person, f"{plan.text()}\nBegin?", realtime) as benches,
        live_session(live, live_to, others) as (feed, inbox),
        TrialView(
            len(ids) * lifts, inbox, OneMessage(lift_note, lift_fault), lifts_done, usual_s
        ) as progress,
    ):
        summary = run_trial(
            folder,
            settings,
            ids,
            lifts,
            jobs=jobs,
            resume=resume,
            benches=benches,
            progress=telling(progress, lift_note, lift_fault),
            live=feed,
            remarks=remarks,
        )
    wall_s = time.perf_counter() - began
    trial_table(summary, simulated, wall_s, to_stderr=json)
    page = report_after(folder, no_report)
    if json:
        figures = {**summary_json(summary), "wall_s": round(wall_s, 2), "report": page}
        emit_json({"session": str(folder), **figures})
    _check_limit(summary, max_mare)


def _partial(folder: Path, wanted: int, simulated: str, began: float, json: bool) -> None:
    """Print the table of the lifts that are done when a trial ends early."""
    import time

    from rig.cli.printing import trial_table
    from rig.results.summary import summarize_trial
    from rig.sessions.rows import read_lifts

    summary = summarize_trial(read_lifts(folder))
    say(f"{summary.lifts_accepted} of {counted(wanted, 'lift')} are done")
    if summary.objects:
        trial_table(summary, simulated, time.perf_counter() - began, to_stderr=json)


def _check_limit(summary: Any, max_mare: float | None) -> None:
    if max_mare is None:
        return
    reached = summary.mare.mean_deg if summary.mare else float("inf")
    if reached > max_mare:
        say(f"rig: MARE {reached:.2f} degrees is above the limit of {max_mare:g} given with --max-mare")
        raise typer.Exit(Exit.LIMIT_MISSED)
