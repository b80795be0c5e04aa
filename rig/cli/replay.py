"""`rig replay`: the lifts of one or many sessions again, from the stored frames."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.errors import counted
from rig.cli.common import JsonOption, ResumeStoredOption, emit_json, report_broken, say, trial_jobs
from rig.cli.places import folder_place

if TYPE_CHECKING:
    from rig.experiments.batch_replay import ReplayPlan


def replay(
    sessions: Annotated[
        list[Path] | None, typer.Argument(help="Session folders of trials, or folders of them.")
    ] = None,
    estimator: Annotated[
        str | None,
        typer.Option(
            "--estimator", help="Default: the session's own; one that is not the rig's has to be named."
        ),
    ] = None,
    window: Annotated[
        int | None, typer.Option("--window", min=1, max=100, help="Default: the session's.")
    ] = None,
    jobs: Annotated[int | None, typer.Option("--jobs", min=1, max=64, help="Lifts side by side.")] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            help="Folder for the table of all lifts (results.csv and .parquet); default, with many "
            "sessions: sessions/<date>_replay.",
            callback=folder_place,
        ),
    ] = None,
    resume: ResumeStoredOption = False,
    engine: Annotated[
        str | None,
        typer.Option("--engine", help="dask://HOST:PORT of a running cluster instead of this computer."),
    ] = None,
    json: JsonOption = False,
) -> None:
    """Estimate every lift again; with the session's own estimator the results are identical.

    Many sessions (or --out) give one table with a line per lift.
    A run that was stopped or killed goes on with --resume.
    A broken session is named in the table and the rest goes on; exit code 2.

    Examples:
      rig replay sessions/2026-11-21T093000_trial

      rig replay sessions/2026-11-21T093000_trial --estimator pca --window 4

      rig replay sessions/* --estimator ellipse --jobs 8 --out sessions/ellipse --resume

      rig replay --resume

      rig replay /data/sessions --engine dask://10.0.0.5:8786 --out /data/again

    """
    from drivers.errors import InputError
    from rig.cli.resuming import continued, may_be_continued, named_again
    from rig.sessions.manifest import ReplayManifest

    if sessions and len(sessions) == 1 and not (out or resume or engine):
        from rig.results.listing import holds_sessions

        if not holds_sessions(sessions[0]):
            _replay_one(sessions[0], estimator, window, jobs, json)
            return
    folder, stored = continued(ReplayManifest, "replay", None, out, resume)
    if stored is not None:
        sessions = sessions or [Path(session) for session in stored.sessions]
        estimator, window = named_again(estimator, stored.estimator), window or stored.window
    if not sessions:
        raise InputError("which sessions? give their folders, or a folder that holds them")
    with may_be_continued(folder, out, resume, no_report=True, partial=lambda: _partial(folder, json)):
        _replay_many(sessions, estimator, window, jobs, folder, resume, engine, json)


def _replay_one(
    session: Path, estimator: str | None, window: int | None, jobs: int | None, json: bool
) -> None:
    import time

    from rig.cli.interrupted import interrupted_json, interrupted_text
    from rig.cli.printing import TrialProgress, summary_json, trial_table
    from rig.experiments.replay import run_replay
    from rig.experiments.stored_trial import stored_trial

    began = time.perf_counter()
    trial = stored_trial(session, estimator, window)
    simulated = "SIMULATED " if trial.manifest.simulated else ""
    choice = trial.settings.estimator
    say(f"{simulated}session {session}, estimator {choice.name}, window {choice.window}")
    if note := trial.truth_note:
        say(note)
    with TrialProgress(1) as progress:
        result = run_replay(trial, trial_jobs(jobs, True, False), progress)
    wall_s = time.perf_counter() - began
    if result.rows:
        trial_table(result.summary, simulated, wall_s, to_stderr=json)
    if result.identical is not None:
        say(f"{result.identical} of {counted(len(result.rows), 'lift')} exactly as stored")
    for lift in result.interrupted:
        say(interrupted_text(lift))
    if json:
        figures = {**summary_json(result.summary), "wall_s": round(wall_s, 2), "identical": result.identical}
        if result.interrupted:
            figures["unfinished"] = [interrupted_json(lift) for lift in result.interrupted]
        emit_json({"session": str(session), "estimator": choice.name, **figures})
    report_broken(result.problems)


def _replay_many(
    paths: list[Path],
    estimator: str | None,
    window: int | None,
    jobs: int | None,
    folder: Path,
    resume: bool,
    engine: str | None,
    json: bool,
) -> None:
    import time

    from rig.cli.printing import WorkProgress
    from rig.cli.results import print_results, results_json, row_note
    from rig.experiments.batch_replay import gather_sessions, plan_replays, replay_manifest, run_replays
    from rig.experiments.dask_engine import runner

    began = time.perf_counter()
    run = runner(engine, trial_jobs(jobs, True, False))
    folders = [path for path in gather_sessions(paths) if path != folder.resolve()]
    plan = plan_replays(folders, estimator, window)
    manifest = replay_manifest(folders, estimator, window)
    _say_plan(plan, estimator)
    with WorkProgress(len(plan.tasks), "lifts") as bar:
        rows = run_replays(
            folder,
            plan,
            manifest,
            run,
            resume,
            lambda done, total, row: bar.show(done, total, row_note(row)),
        )
    wall_s = round(time.perf_counter() - began, 2)
    print_results(rows, by="session", to_stderr=json)
    say(f"{folder}/results.csv: {counted(len(rows), 'line')}, {wall_s:.1f} s")
    if json:
        emit_json({"out": str(folder), **results_json(rows), "wall_s": wall_s})
    report_broken([row.problem for row in rows if row.problem])


def _partial(folder: Path, json: bool) -> None:
    """Print the table of the lifts that are replayed when the command ends early."""
    from rig.cli.results import print_results
    from rig.sessions.files import RESULTS
    from rig.sessions.rows import read_rows
    from rig.sessions.table_files import REPLAYS

    print_results(read_rows(folder / RESULTS["replay"], REPLAYS), by="session", to_stderr=json)


def _say_plan(plan: "ReplayPlan", estimator: str | None) -> None:
    sessions = {task.trial.folder: task.trial for task in plan.tasks}
    simulated = "SIMULATED " if any(trial.manifest.simulated for trial in sessions.values()) else ""
    say(
        f"{simulated}{counted(len(plan.tasks), 'lift')} of {counted(len(sessions), 'session')}, "
        f"estimator {estimator or 'of each session'}"
    )
    notes = [note for _, trial in sorted(sessions.items()) if (note := trial.truth_note)]
    if notes:
        say(f"{len(notes)} of {counted(len(sessions), 'session')}: {notes[0]}")
    for path, why in (*plan.left_out, *plan.broken):
        say(f"left out: {path}: {why.removeprefix(f'{path}: ')}")
