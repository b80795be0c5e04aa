"""The lifts of a session again, from their stored frames, with any estimator."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from drivers.errors import InputError, SessionError
from rig.experiments.lift_attempt import TrialSettings, new_measurement
from rig.experiments.process_pool import run_tasks
from rig.lift.result import lift_result
from rig.results.summary import TrialSummary, summarize_trial
from rig.sessions.files import read_lines
from rig.sessions.layout import RESULTS
from rig.sessions.reading import show_again
from rig.sessions.session import manifest_bench, read_manifest
from rig.tactile.estimators import EstimatorChoice, choose_estimator


@dataclass(frozen=True, slots=True)
class Replay:
    """What a replay gave: its summary, rows, and how many lifts equal the stored ones bit for bit."""

    summary: TrialSummary
    rows: list[dict[str, Any]]
    identical: int


def run_replay(
    folder: Path,
    estimator: str | None,
    window: int | None,
    jobs: int,
    progress: Callable[[int, int, dict[str, Any]], None] = lambda done, total, row: None,
) -> Replay:
    """Replay all accepted lifts of a session; nothing in the session changes.

    estimator, window: those of the session when None. Raises `SessionError` for a folder that
    is none, holds no finished lift, or has a damaged recording.
    """
    settings = session_settings(folder, estimator, window)
    stored = {row["number"]: row for row in read_lines(folder / RESULTS["trial"]) if row["accepted"]}
    if not stored:
        raise SessionError(f"{folder}: no finished lift to replay; run it with --resume first")
    rows: dict[int, dict[str, Any]] = {}
    work = partial(replay_lift, folder, settings)
    for _, row in run_tasks(work, list(stored.values()), jobs):
        rows[row["number"]] = row
        progress(len(rows), len(stored), row)
    in_order = [rows[number] for number in sorted(rows)]
    identical = sum(same_as_stored(row, stored[row["number"]]) for row in in_order)
    return Replay(summarize_trial(in_order), in_order, identical)


def replay_lift(folder: Path, settings: TrialSettings, row: dict[str, Any]) -> dict[str, Any]:
    """Watch one recorded lift again; return its row with the measured part made anew."""
    watched = new_measurement(settings)
    show_again(folder / row["recording"], watched)
    measured, _ = lift_result(watched)
    return {**row, **measured}


def same_as_stored(row: dict[str, Any], stored: dict[str, Any]) -> bool:
    """Whether a replayed row equals the stored one bit for bit, as both look on disk."""
    return json.loads(json.dumps(row)) == stored


def session_settings(folder: Path, estimator: str | None, window: int | None) -> TrialSettings:
    """Return the settings a trial session was made with. Raises `SessionError`."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such session folder")
    manifest = read_manifest(folder)
    if manifest.get("kind") != "trial":
        raise SessionError(
            f"{folder}: is a '{manifest.get('kind')}' session; only trials have lifts to replay"
        )
    bench = manifest_bench(folder, manifest)
    try:
        return TrialSettings(bench, manifest["seed"], _choice(manifest, estimator, window))
    except KeyError as error:
        raise SessionError(f"{folder}/session.json: {error} is missing; the session is damaged") from error


def _choice(manifest: dict[str, Any], estimator: str | None, window: int | None) -> EstimatorChoice:
    """Return the session's own estimator, or another with its usual window."""
    if estimator is None or estimator == manifest["estimator"]:
        return choose_estimator(
            manifest["estimator"], window or manifest["window"], manifest.get("skip", True)
        )
    return choose_estimator(estimator, window)
