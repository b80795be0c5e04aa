"""Drawn sessions: small folders as a trial or a recording leaves them, with curves that are known."""

import io
import json
import shutil
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.images import with_jpeg
from drivers.types import Frame
from rig.config import BenchConfig, load_bench
from rig.results.metrics import summarize
from rig.sessions.codec import json_line, json_value
from rig.sessions.files import write_json
from rig.sessions.manifest import Manifest, RecordManifest, TrialManifest
from rig.sessions.recorder import LiftRecorder
from rig.sessions.records import ErrorSummary, Lift, LiftOutcome, LiftTiming, PoseImage, PoseRow, StageTimes
from rig.tactile.angles import FUSED, MARKERS, Angles

Press = Callable[..., NDArray[np.uint8]]
Drawn = Callable[..., Path]
TIPS = {"T1": 1, "T2": -1}
PHASES_S = {"reference": 10.0, "A": 10.2, "B": 11.2, "C": 12.7, "lower": 13.7}
SMALL: dict[str, Any] = {"size": (120, 160), "half_axes": (42.0, 18.0), "center": (60.0, 80.0)}
MANIFEST = {
    "schema_version": 2, "tool_version": "0.1.0", "status": "complete", "bench": "fake",
    "started": "2026-11-21T09:30:00+00:00", "simulated": True, "seed": 0,
    "serials": (*TIPS, "CAM"), "signs": TIPS, "calibration": {}, "objects": ("t1",),
}  # fmt: skip


def true_angle(time_s: NDArray[np.float64], turn_deg: float) -> NDArray[np.float64]:
    """Rest until 0.3 s after the lift began, then a ramp of 0.9 s, then rest."""
    return turn_deg * np.clip((time_s - PHASES_S["B"] - 0.3) / 0.9, 0.0, 1.0)


@cache
def _lift(number: int, turn_deg: float, error_deg: float, press: Press) -> tuple[Lift, bytes]:
    stream = io.BytesIO()
    recorder = LiftRecorder(stream)
    for phase, begins in PHASES_S.items():
        recorder.phase(phase, round(begins * 1e9))
    for sequence, time_s in enumerate(np.arange(10.0, 13.7, 0.1)):
        for serial, sign in TIPS.items():
            angle = 20.0 + sign * float(true_angle(np.array(time_s), turn_deg))
            image = press(angle if time_s > 10.3 else None, seed=sequence, **SMALL)
            recorder.frame(with_jpeg(Frame(image, round(time_s * 1e9), sequence, serial)))
        view = np.full((60, 80, 3), 90, np.uint8)
        recorder.frame(with_jpeg(Frame(view, round(time_s * 1e9), sequence, "CAM")))
    times = np.arange(PHASES_S["B"], PHASES_S["lower"], 1 / 60)
    noise = np.random.default_rng(number).normal(0.0, 0.1, times.size)
    estimate = true_angle(times, turn_deg) + error_deg * np.clip(times - 11.5, 0.0, 1.0) + noise
    for source in (*TIPS, FUSED):
        _values(recorder, source, times, estimate)
    all_times = np.arange(10.3, 13.8, 1 / 30)
    _values(recorder, MARKERS, all_times, true_angle(all_times, turn_deg))
    recorder.close()
    errors = np.abs(estimate - true_angle(times, turn_deg))
    measured = {
        "re": summarize(errors), "re_b": summarize(errors[times < PHASES_S["C"]]),
        "re_held": summarize(errors), "final_estimate_deg": float(estimate[-18:].mean()),
    }  # fmt: skip
    return a_lift(number, final_truth_deg=turn_deg, **measured), stream.getvalue()


def a_lift(number: int = 1, fault: str | None = None, **changes: Any) -> Lift:
    """A lift as a trial stores it. fault: that ended it."""
    error = ErrorSummary(0.5, 0.1, 1.0, 150)
    row = Lift(
        number=number, attempt=0, object="t1", name="wrench", lift=number, position="left", accepted=True,
        outcome=LiftOutcome.SLIPPED, bench_s=4.0, recording=f"lifts/{number:03d}.mcap",
        re=error, re_b=error, re_held=error, answered=1.0, grip_counts=4, lift_height_m=0.05,
        contact_area_px=dict.fromkeys(TIPS, 9000.0), final_estimate_deg=12.0, final_truth_deg=12.0,
        onset_truth_s=0.34, onset_estimate_s=0.38, onset_alarm_s=0.40,
        phases_s=dict(PHASES_S),
        frames={**dict.fromkeys(TIPS, 150), "camera": 75}, dropped=dict.fromkeys((*TIPS, "camera"), 0),
        states={"tracking": 300, "lost": 0}, skipped={"alignment": 10}, disagreements={"tilt": 0},
        seed=number, simulated=True,
    )  # fmt: skip
    row = replace(row, **changes)
    if fault is None:
        return row
    plan = {of.name: getattr(row, of.name) for of in fields(Lift) if "figure" not in of.metadata}
    return Lift(**{**plan, "accepted": False, "outcome": LiftOutcome.FAULT, "fault": fault})


@pytest.fixture(scope="session")
def lift_row() -> Callable[..., Lift]:
    """Makes a lift's row: `lift_row(number, **changes)`."""
    return a_lift


def _values(recorder: LiftRecorder, source: str, times: Any, angles: Any) -> None:
    states = ("tracking",) * times.size
    recorder.angles(Angles(times, angles, np.full(times.size, 0.5), states, source=source))


@pytest.fixture(scope="session")
def drawn_trial(press: Press) -> Drawn:
    """Writes a trial: `drawn_trial(folder, turns_deg, errors_deg, **manifest)`."""

    def write(
        folder: Path,
        turns_deg: tuple[float, ...] = (12.0, -20.0),
        errors_deg: tuple[float, ...] = (),
        **more: Any,
    ) -> Path:
        errors = errors_deg or (0.5,) * len(turns_deg)
        (folder / "lifts").mkdir(parents=True)
        rows = []
        for number, (turn, error) in enumerate(zip(turns_deg, errors, strict=True), start=1):
            row, recording = _lift(number, turn, error, press)
            (folder / row.recording).write_bytes(recording)
            rows.append(row)
        stages = dict.fromkeys(("contact", "total"), StageTimes(1.2, 2.0, 3.0))
        took = [LiftTiming(number=row.number, attempt=0, wall_s=4.0, stages=stages) for row in rows]
        _lines(folder / "lifts.jsonl", rows)
        _lines(folder / "timing.jsonl", took)
        asked = {"estimator": "slip", "window": 1, "skip": True, "truth": "edges", **more}
        values = {**MANIFEST, "config": _bench(), "kind": "trial", "lifts_per_object": len(rows), **asked}
        _manifest(folder, TrialManifest(**values))
        return folder

    return write


@pytest.fixture(scope="session")
def drawn_recording(press: Press) -> Drawn:
    """Writes a recording of two poses, the second one after a failed attempt."""

    def write(folder: Path, **more: Any) -> Path:
        images = folder / "t1_wrench" / "image_label"
        images.mkdir(parents=True)
        (folder / "reference").mkdir()
        for serial in TIPS:
            _png(folder / "reference" / f"{serial}.png", press(None, **SMALL))
        fault = replace(_pose(2, ()), accepted=False, fault="GraspError: the fingers closed on nothing")
        done = [_pose(1, _images(images, 1, press)), fault, _pose(2, _images(images, 2, press), 1)]
        _lines(folder / "poses.jsonl", done)
        values = {**MANIFEST, "config": _bench(), "kind": "record", "poses": 2, "images": 12, **more}
        _manifest(folder, RecordManifest(**values))
        return folder

    return write


def _pose(pose: int, images: tuple[PoseImage, ...], attempt: int = 0) -> PoseRow:
    return PoseRow(
        pose=pose, attempt=attempt, position="left", orientation_deg=15.0 * pose, accepted=True, fault=None,
        rejected_frames=3, images=images, seed=0, simulated=True,
    )  # fmt: skip


def _images(folder: Path, pose: int, press: Press) -> tuple[PoseImage, ...]:
    found = []
    for number in range(6):
        serial = "T1" if number % 2 else "T2"
        file = folder / f"p{pose:02d}_{number + 1:02d}_{serial}.png"
        _png(file, press(25.0 * pose + number, seed=number, **SMALL))
        name = str(file.relative_to(folder.parents[1]))
        found.append(
            PoseImage(
                file=name, grip_counts=number, serial=serial, time_s=float(number), contact_area_px=9000.0
            )
        )
    return tuple(found)


def _bench() -> BenchConfig:
    """The simulated bench with this file's sensors."""
    bench = load_bench("fake")
    tactile = [t.model_copy(update={"serial": s}) for t, s in zip(bench.tactile, TIPS, strict=True)]
    camera = bench.camera.model_copy(update={"serial": "CAM"})
    return bench.model_copy(update={"tactile": tuple(tactile), "camera": camera})


def _png(path: Path, image: NDArray[np.uint8]) -> None:
    cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))


def _lines(path: Path, records: Sequence[Any]) -> None:
    path.write_bytes(b"".join(map(json_line, records)))


def _manifest(folder: Path, manifest: Manifest) -> None:
    write_json(folder / "session.json", json_value(manifest))


@pytest.fixture(scope="session")
def stored_trial_twice() -> Callable[[Path], Path]:
    """Copies the stored trial to a writable folder, with its lift a second time as lift 2."""

    def copy(folder: Path) -> Path:
        shutil.copytree(Path(__file__).parents[1] / "data" / "stored_trial", folder)
        row = json.loads((folder / "lifts.jsonl").read_text())
        second = {**row, "number": 2, "lift": 2, "recording": "lifts/002.mcap"}
        (folder / "lifts.jsonl").write_text(f"{json.dumps(row)}\n{json.dumps(second)}\n")
        shutil.copy(folder / "lifts" / "001.mcap", folder / "lifts" / "002.mcap")
        return folder

    return copy
