"""Made sessions: the files of a trial with lifts that nobody lifted, for what only looks at their size."""

import os
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np

from protocols.observer import Phase
from rig.config import BenchConfig
from rig.experiments.lift_attempt import TrialSettings
from rig.experiments.trial import trial_manifest
from rig.sessions.codec import json_line, json_value
from rig.sessions.files import write_json
from rig.sessions.layout import MANIFEST, RECORDINGS, RESULTS, TIMING, recording_file
from rig.sessions.records import ErrorSummary, FinishedLift, LiftOutcome
from rig.sessions.timing import LiftTiming, StageTimes
from rig.tactile.estimators import choose_estimator

RECORDING_BYTES = 20_000_000
"""Of a lift; sparse, so that a thousand sessions need no disk."""
_OBJECTS = ("1", "7", "t1", "t2", "t3", "t4", "t5", "t6", "t7")
_FIRST = datetime(2026, 1, 5, 9, 0, tzinfo=UTC)


def make_session(folder: Path, bench: BenchConfig, number: int, lifts: int) -> None:
    """Write a complete trial of so many lifts, the number-th of a series, an hour after the one before."""
    rng = np.random.default_rng((number, 71))
    (folder / RECORDINGS).mkdir(parents=True)
    begun = _FIRST + timedelta(hours=number)
    settings = TrialSettings(bench, number, choose_estimator())
    manifest = replace(
        trial_manifest(settings, list(_OBJECTS), -(-lifts // len(_OBJECTS))),
        started=begun.isoformat(timespec="seconds"),
        completed=(begun + timedelta(minutes=20)).isoformat(timespec="seconds"),
        status="complete",
    )
    write_json(folder / MANIFEST, json_value(manifest))
    rows = [_lift(i, rng) for i in range(1, lifts + 1)]
    (folder / RESULTS["trial"]).write_bytes(b"".join(map(json_line, rows)))
    (folder / TIMING).write_bytes(b"".join(json_line(_timing(row.number)) for row in rows))
    for row in rows:
        with (folder / row.recording).open("wb") as stream:
            os.truncate(stream.fileno(), RECORDING_BYTES)


def _lift(number: int, rng: np.random.Generator) -> FinishedLift:
    mean_deg, std_deg, max_deg = (float(v) for v in rng.uniform((0.1, 0.1, 0.6), (0.6, 0.6, 2.0)))
    error = ErrorSummary(mean_deg, std_deg, max_deg, 300)
    onset_s, turn_deg = float(rng.uniform(0.2, 1.0)), float(rng.uniform(-25.0, 25.0))
    object_id = _OBJECTS[(number - 1) % len(_OBJECTS)]
    return FinishedLift(
        number=number, attempt=0, object=object_id, name=f"object {object_id}",
        lift=1 + (number - 1) // len(_OBJECTS),
        position="left", grip_counts=4, lift_height_m=0.05, force_n=None, seed=number, simulated=True,
        recording=recording_file(number, 0), accepted=True, outcome=LiftOutcome.SLIPPED, re_b=error, re=error,
        re_held=error, contact_area_px={"SIM-D0001": 9000.0, "SIM-D0002": 8700.0}, answered=1.0,
        final_estimate_deg=turn_deg, final_truth_deg=turn_deg + 0.1, onset_truth_s=onset_s,
        onset_estimate_s=onset_s + 0.02, onset_alarm_s=onset_s + 0.05,
        phases_s={phase.value: 3.0 * i for i, phase in enumerate(Phase)},
        frames={"SIM-D0001": 610, "SIM-D0002": 610, "camera": 305},
        dropped={"SIM-D0001": 0, "SIM-D0002": 0, "camera": 0},
        states={"tracking": 900, "rekeyed": 4, "no_contact": 300, "lost": 6, "unobservable": 10},
        skipped={"segmentation": 700}, disagreements={"angle": 0}, bench_s=13.5, speed_fraction=1.0,
    )  # fmt: skip


def _timing(number: int) -> LiftTiming:
    return LiftTiming(number=number, attempt=0, wall_s=9.0, stages={"slip": StageTimes(1.2, 4.0, 9.0)})
