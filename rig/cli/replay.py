"""`rig replay`: the lifts of a session again, from the stored frames."""

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.common import JsonOption, emit_json, say, trial_jobs


def replay(
    session: Annotated[Path, typer.Argument(help="Session folder of a trial.")],
    estimator: Annotated[str | None, typer.Option("--estimator", help="Default: the session's own.")] = None,
    window: Annotated[
        int | None, typer.Option("--window", min=1, max=100, help="Default: the session's.")
    ] = None,
    jobs: Annotated[int | None, typer.Option("--jobs", min=1, max=64, help="Lifts side by side.")] = None,
    json: JsonOption = False,
) -> None:
    """Estimate every lift of a session again; with its own estimator the results are identical.

    Examples:
      rig replay sessions/2026-11-21T093000_trial

      rig replay sessions/2026-11-21T093000_trial --estimator pca --window 4

    """
    import time

    from rig.cli.tables import TrialProgress, summary_json, trial_table
    from rig.replay import run_replay, session_settings

    began = time.perf_counter()
    settings = session_settings(session, estimator, window)
    simulated = "SIMULATED " if settings.bench.simulated else ""
    say(
        f"{simulated}session {session}, estimator {settings.estimator.name}, "
        f"window {settings.estimator.window}"
    )
    with TrialProgress(1) as progress:
        result = run_replay(session, estimator, window, trial_jobs(jobs, True, False), progress)
    wall_s = time.perf_counter() - began
    trial_table(result.summary, simulated, wall_s, to_stderr=json)
    say(f"{result.identical} of {len(result.rows)} lifts give exactly the stored results")
    if json:
        figures = {**summary_json(result.summary), "wall_s": round(wall_s, 2), "identical": result.identical}
        emit_json({"session": str(session), "estimator": settings.estimator.name, **figures})
