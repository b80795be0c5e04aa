"""`rig replay`: estimate the lifts of one or many sessions again, from the stored frames."""

import time
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import EstimatorError, InputError, plural
from rig.cli.common import emit_json, mark, report_broken, report_faults, say, trial_jobs
from rig.cli.options import EngineOption, JsonOption, ResumeOption, SessionOptions
from rig.cli.results import print_results, trial_table
from rig.declared import argument, folder_place, option
from rig.terminal.progress import WorkProgress


@dataclass(frozen=True, slots=True)
class ReplayOptions:
    sessions: list[Path] | None = argument(None, "Session folders of trials, or folders that hold them.")
    estimator: str | None = option(
        None, "Estimator. Default: the session's own; if that is your own class, it has to be named here."
    )
    window: int | None = option(None, "Mean of the last n angles. Default: the session's.", min=1, max=100)
    jobs: int | None = option(None, "Lifts in parallel. Default: one per core.", min=1, max=64)
    out: Path | None = option(
        None,
        "Folder for the table of all lifts (results.csv and results.parquet). Default for many sessions: "
        "sessions/<date>_replay.",
        callback=folder_place,
    )
    resume: ResumeOption = False
    engine: EngineOption = None
    json: JsonOption = False


def replay(options: ReplayOptions) -> None:
    """Estimate the lifts of sessions again from the stored frames.

    With the session's own estimator, the results are compared with the stored ones: identical with the same
    commit on the same kind of processor, within 0.05 degrees on another kind. Several sessions, or --out,
    give one table with a row per lift. --resume continues a run that was stopped or killed. A broken session
    is listed in the table and skipped; the exit code is then 2.

    Examples:
      rig replay sessions/2026-11-21T093000_trial
      rig replay sessions/2026-11-21T093000_trial --estimator pca --window 4
      rig replay sessions/* --estimator ellipse --jobs 8 --out sessions/ellipse --resume
      rig replay --resume
      rig replay /data/sessions --engine dask://HOST:PORT --out /data/again
    """
    from rig.results.listing import holds_sessions

    one = options.sessions or []
    if len(one) == 1 and not (options.out or options.resume or options.engine or holds_sessions(one[0])):
        _replay_one(one[0], options)
    else:
        _replay_many(options)


def _replay_one(session: Path, options: ReplayOptions) -> None:
    from rig.experiments.lift_plan import stored_trial
    from rig.experiments.replay import run_replay
    from rig.results.notes import agreement_text, lift_note

    began = time.perf_counter()
    trial = stored_trial(session, options.estimator, options.window)
    simulated, choice = mark(trial.manifest.simulated), trial.settings.estimator
    say(f"{simulated}session {session}, estimator {choice.name}, window {choice.window}")
    with WorkProgress(1, "lifts") as bar:
        result = run_replay(trial, trial_jobs(options.jobs, True, False), bar.showing(lift_note))
    wall_s = time.perf_counter() - began
    trial_table(result.summary, simulated, wall_s, to_stderr=options.json)
    found = result.agreement
    if found:
        say(agreement_text(found, [trial.manifest]))
    if options.json:
        figures = {**result.summary.as_json(), "wall_s": round(wall_s, 2)}
        figures |= {name: getattr(found, name, None) for name in ("identical", "difference_deg")}
        emit_json({"session": str(session), "estimator": choice.name, **figures})
    report_broken(result.problems)
    report_faults(row.estimator_faults for row in result.rows if row.estimator_faults)


def _replay_many(options: ReplayOptions) -> None:
    """Replay into one table; continue the one in --out with --resume. Raises `InputError`."""
    from rig.cli.resuming import may_be_continued, named_again, session_to_continue
    from rig.experiments.process_pool import runner
    from rig.experiments.replay import gather_sessions, plan_replays, replay_manifest, run_replays
    from rig.results.notes import row_note
    from rig.results.table import REPLAYS, results_json
    from rig.sessions.files import RESULTS
    from rig.sessions.manifest import ReplayManifest
    from rig.sessions.rows import read_rows

    session = SessionOptions(out=options.out, resume=options.resume, no_report=True)
    folder, stored = session_to_continue(ReplayManifest, "replay", None, session)
    paths, estimator, window = options.sessions, options.estimator, options.window
    if stored is not None:
        paths = paths or [Path(each) for each in stored.sessions]
        estimator, window = named_again(estimator, stored.estimator), window or stored.window
    if not paths:
        raise InputError("no session given: give session folders, or a folder that holds them")

    def print_partial() -> None:
        print_results(read_rows(folder / RESULTS["replay"], REPLAYS), options.json)

    with may_be_continued(folder, session, print_partial):
        began = time.perf_counter()
        run = runner(options.engine, trial_jobs(options.jobs, True, False))
        folders = [path for path in gather_sessions(paths) if path != folder.resolve()]
        plan = plan_replays(folders, estimator, window)
        manifest = replay_manifest(folders, estimator, window)
        trials = {task.trial.folder: task.trial for task in plan.tasks}
        simulated = mark(any(trial.manifest.simulated for trial in trials.values()))
        say(
            f"{simulated}{plural(len(plan.tasks), 'lift')} of {plural(len(trials), 'session')}, "
            f"estimator {estimator or 'of each session'}"
        )
        for path, why in (*plan.left_out, *plan.broken):
            say(f"left out: {path}: {why.removeprefix(f'{path}: ')}")
        with WorkProgress(len(plan.tasks), "lifts") as bar:
            rows = run_replays(folder, plan, manifest, run, options.resume, bar.showing(row_note))
        wall_s = round(time.perf_counter() - began, 2)
        print_results(rows, options.json, [trial.manifest for trial in trials.values()])
        say(f"{folder}/results.csv: {plural(len(rows), 'line')}, {wall_s:.1f} s")
        if options.json:
            emit_json({"out": str(folder), **results_json(rows), "wall_s": wall_s})
        report_broken([str(row["problem"]) for row in rows if row["problem"]])
        if faults := [row["estimator_fault"] for row in rows if row["estimator_fault"]]:
            raise EstimatorError(f"done, but in {plural(len(faults), 'lift')} {faults[0]}")
