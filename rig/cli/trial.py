"""`rig trial`: lift objects, measure their rotation, and compare it with the markers."""

import time
from dataclasses import asdict, dataclass
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from drivers.errors import plural
from rig.cli.common import Exit, emit_json, mark, report_faults, say, trial_jobs
from rig.cli.options import RunOptions
from rig.cli.report import report_after
from rig.cli.results import print_limits, trial_table
from rig.cli.resuming import (
    bench_of,
    dry_run,
    lifts_done,
    may_be_continued,
    named_again,
    person_at,
    serve_watch_page,
    session_to_continue,
)
from rig.declared import option, resume_options
from rig.terminal.onlookers import announcing
from rig.terminal.screen import begin_phase

MOST_MISSED = 10
"""Largest number of missed limits that are printed one by one."""

if TYPE_CHECKING:
    from rig.bench.plan import Plan
    from rig.experiments.lift_plan import TrialSettings
    from rig.results.limits import Judged
    from rig.results.summary import TrialSummary


@dataclass(frozen=True)
class LiftOptions:
    lifts: int = option(5, "Accepted lifts per object.", min=1, max=1000, stored="lifts_per_object")
    objects: list[str] | None = option(
        None,
        "Object, by id or name; repeat for more. Default: the nine objects of the paper's trial.",
        "--object",
        stored="objects",
        read=list,
    )
    limits: Path | None = option(
        None,
        "File with limits of figures of lifts and session (docs/report.md), in place of those of the bench "
        "file. If one is missed, the exit code is 4.",
    )
    max_mare: float | None = option(
        None,
        "Limit of the MARE (mean absolute error of the angle, phases B and C), degrees.",
        min=0.0,
    )
    realtime: bool = option(False, "Run a simulated bench in real time. Default: as fast as possible.")
    jobs: int | None = option(
        None, "Lifts in parallel on a simulated bench. Default: one per core.", min=1, max=64
    )
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
    markers_only: bool = option(
        False,
        "Store only the surroundings of the markers of the external camera's pictures, the rest in grey. "
        "A lift then takes 14 instead of 22 MB.",
        "--markers-only",
        stored="markers_only",
    )
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


@dataclass(frozen=True)
class TrialOptions(RunOptions, LiftOptions):
    pass


def trial(context: typer.Context, options: TrialOptions) -> None:
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
      rig trial --lifts 50 --markers-only
      rig trial --lifts 5 --limits limits.toml
    """
    from rig.sessions.rows import read_finished_lifts

    began = time.perf_counter()
    lifting = _prepare(context, options)
    if options.dry:
        dry_run(lifting.settings.bench, lifting.plan(), options.json)
    summary = _lift_all(context, lifting, began)
    wall_s = time.perf_counter() - began
    trial_table(summary, lifting.simulated, wall_s, options.json, lifting.earlier_s)
    judged = _apply_limits(lifting)
    print_limits(judged, options.json)
    page = report_after(lifting.folder, options.no_report)
    if options.json:
        figures = {**summary.as_json(), "wall_s": round(wall_s, 2), "report": page}
        figures |= {"limits": [asdict(one) for one in judged]} if judged else {}
        emit_json({"session": str(lifting.folder), **figures})
    report_faults(row.estimator_faults for row in read_finished_lifts(lifting.folder) if row.estimator_faults)
    if missed := [one for one in judged if not one.met]:
        lines = [f"rig: limit missed: {one}" for one in missed[:MOST_MISSED]]
        if len(missed) > MOST_MISSED:
            lines.append(f"rig: and {len(missed) - MOST_MISSED} more in {lifting.folder}/limits.jsonl")
        say("\n".join(lines))
        raise typer.Exit(Exit.LIMIT_MISSED)


def _apply_limits(lifting: "_Trial") -> "list[Judged]":
    """Compare the finished trial with its limits; write `limits.jsonl` and, for CI systems, `limits.xml`."""
    from rig.results.limits import apply_limits, json_lines, junit_xml
    from rig.sessions.files import write_file
    from rig.sessions.rows import read_lifts, read_timing

    folder = lifting.folder
    found = apply_limits(lifting.settings.bench.limits, read_lifts(folder), read_timing(folder))
    if found:
        write_file(folder / "limits.jsonl", json_lines(found).encode())
        write_file(folder / "limits.xml", junit_xml(found, folder.name).encode())
    return found


@dataclass(frozen=True, slots=True)
class _Trial:
    """A trial to begin or to resume.

    options: of a resumed trial the stored ones, unless others were given. done: number of finished lifts.
    earlier_s: bench time of all attempts until now. usual_s: mean time per finished lift; None without one.
    """

    options: TrialOptions
    settings: "TrialSettings"
    folder: Path
    objects: list[str]
    jobs: int
    done: int
    earlier_s: float
    usual_s: float | None

    @property
    def simulated(self) -> str:
        """Prefix of printed results: "SIMULATED ", or "" on a real bench."""
        return mark(self.settings.bench.simulated)

    @property
    def wanted(self) -> int:
        return len(self.objects) * self.options.lifts

    def plan(self) -> "Plan":
        """Return the plan that is shown before anything moves. Raises `InputError`."""
        from rig.experiments.trial import trial_plan

        return trial_plan(self.settings, self.objects, self.options.lifts)


def _prepare(context: typer.Context, options: TrialOptions) -> _Trial:
    """Read the bench and the session to resume; return the trial with its settings. Raises `InputError`."""
    from protocols.reaction import ReactionKind
    from rig.config.models import LimitConfig
    from rig.config.objects import with_more
    from rig.experiments.lift_plan import TrialSettings, require_reaction
    from rig.experiments.trial import resolve_objects, trial_manifest
    from rig.lift.slip_watch import SlipSettings
    from rig.results.limits import checked_limits, read_limits
    from rig.sessions.manifest import TrialManifest
    from rig.sessions.session import require_same
    from rig.tactile.estimators import DEFAULT_ESTIMATOR, choose_estimator

    options.remarks()  # an invalid one is reported first
    config = bench_of(context, options, "rig trial")
    folder, stored = session_to_continue(TrialManifest, "trial", config.name, options)
    if stored is not None:
        config = with_more(config, stored.config.objects)
        named_again(options.estimator, stored.estimator)
        options = resume_options(options, stored, context)
    choice = choose_estimator(options.estimator, options.window, not options.no_skip)
    slip = SlipSettings(options.alarms_per_hour, options.max_turn_deg)
    kind = ReactionKind(options.react)
    objects = resolve_objects(options.objects, config.objects)
    if options.limits is not None:
        given = read_limits(options.limits)
    else:
        given = config.limits or (() if stored is None else stored.config.limits)
    if options.max_mare is not None:
        others = [of for of in given if (of.figure, of.object) != ("mare_deg", None)]
        given = (*others, LimitConfig(figure="mare_deg", upper=options.max_mare))
    file = Path(options.bench) if options.limits is None else options.limits
    given = checked_limits(given, objects, config.objects, file, all_apply=options.limits is not None)
    config = config.model_copy(update={"limits": given})
    settings = TrialSettings(config, options.seed, choice, options.realtime, kind, slip, options.markers_only)
    require_reaction(settings, objects)
    jobs = trial_jobs(options.jobs, config.in_process, options.realtime)
    if stored is not None:
        require_same(folder, stored, trial_manifest(settings, objects, options.lifts))
    reacting = "" if options.react == "none" else f", reaction to slip '{options.react}'"
    say(
        f"{mark(config.simulated)}bench '{config.name}', seed {options.seed}, estimator {choice.name}"
        f"{reacting}, session {folder}"
    )
    wanted = len(objects) * options.lifts
    parallel = f", {min(jobs, wanted)} at a time" if min(jobs, wanted) > 1 else ""
    say(
        f"{plural(wanted, 'lift')} of {plural(len(objects), 'object')}{parallel}; "
        "the remaining time is shown from the first lift on"
    )
    # Each worker loads the loops of `slip` itself; a dry run does not need them.
    loaded_later = jobs > 1 and not options.realtime
    if choice.name != DEFAULT_ESTIMATOR or not (loaded_later or options.dry):
        begin_phase(f"preparing estimator {choice.name}")
        choice.try_making()
    done, earlier_s, usual_s = (0, 0.0, None) if stored is None else lifts_done(folder, wanted, jobs)
    return _Trial(options, settings, folder, objects, jobs, done, earlier_s, usual_s)


def _lift_all(context: typer.Context, trial: _Trial, began: float) -> "TrialSummary":
    """Lift all objects; return the summary. began: start of the command on the clock of `perf_counter`, s."""
    from rig.bench.source import session_bench
    from rig.experiments.trial import run_trial
    from rig.live.feed import Listener, open_inbox
    from rig.live.trial_view import TrialView
    from rig.results.notes import lift_note
    from rig.results.summary import summarize_trial
    from rig.sessions.rows import read_lifts
    from rig.terminal.progress import OneMessage

    folder, settings, options = trial.folder, trial.settings, trial.options
    config, fault = settings.bench, attrgetter("fault")

    def show_partial() -> None:
        summary = summarize_trial(read_lifts(folder))
        say(f"{summary.lifts_accepted} of {plural(trial.wanted, 'lift')} are done")
        if summary.objects:
            wall_s = time.perf_counter() - began
            trial_table(summary, trial.simulated, wall_s, options.json, trial.earlier_s)

    title = f"{trial.simulated}trial on bench '{config.name}', {folder}"
    question = f"{trial.plan().text()}\nBegin?"
    person, message = person_at(context, options, config), OneMessage(lift_note, fault)
    with (
        may_be_continued(folder, options, show_partial),
        serve_watch_page(context, options, title, "lifts", trial.wanted, trial.done) as others,
        session_bench(config, person, question, settings.realtime) as benches,
        open_inbox() as inbox,
        TrialView(trial.wanted, inbox, message, trial.done, trial.usual_s) as view,
    ):
        return run_trial(
            folder,
            settings,
            trial.objects,
            options.lifts,
            jobs=trial.jobs,
            resume=options.resume,
            benches=benches,
            progress=announcing(view, lift_note, fault),
            live=[Listener(inbox.address, pictures=False), *others],
            remarks=options.remarks(),
        )
