"""Stored rows are written and read strictly; errors name the key."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import SessionError
from rig.config import load_bench
from rig.sessions.codec import json_line, json_value
from rig.sessions.manifest import RecordManifest, TrialManifest, begun_on, read_manifest, read_manifest_of
from rig.sessions.records import (
    LIFT_TIMINGS,
    LIFTS,
    POSES,
    LatencyTimes,
    Lift,
    LiftTiming,
    PoseRow,
    StageTimes,
)
from rig.sessions.rows import read_lifts, readable_rows

MakeRow = Callable[..., Lift]
POSE = PoseRow(
    pose=1, attempt=0, position="left", orientation_deg=-30.0, accepted=True, fault=None, rejected_frames=0,
    images=(), seed=0, simulated=True,
)  # fmt: skip


def test_written_rows_are_read_back_unchanged(lift_row: MakeRow) -> None:
    whole = lift_row(3, re=None, onset_truth_s=None)
    for row in (whole, lift_row(3, fault="lost")):
        assert LIFTS.parse(json_line(row)) == row
    assert POSES.parse(json_line(POSE)) == POSE
    timing = LiftTiming(number=1, attempt=0, wall_s=2.0, stages={"total": StageTimes(1.0, 2.0, 3.0)})
    late = replace(timing, capture_to_angle={"D1": LatencyTimes(1.0, 2.0, 3.0, 4.0)})
    assert [LIFT_TIMINGS.parse(json_line(t)) for t in (timing, late)] == [timing, late]


@given(st.floats(allow_nan=False, allow_infinity=False), st.floats(allow_nan=False, allow_infinity=False))
def test_every_number_is_read_back_bit_for_bit(one: float, other: float) -> None:
    row = replace(POSE, orientation_deg=other)
    assert POSES.parse(json_line(row)) == row
    timing = LiftTiming(number=1, attempt=0, wall_s=one, stages={})
    assert LIFT_TIMINGS.parse(json_line(timing)) == timing


def test_optional_keys_are_absent_at_their_default(lift_row: MakeRow) -> None:
    assert "fault" not in json_value(lift_row(1))
    assert json_value(POSE)["fault"] is None
    assert "capture_to_angle" not in json_value(LiftTiming(number=1, attempt=0, wall_s=1.0, stages={}))
    asked = RecordManifest(**vars(begun_on(load_bench("fake"), "record", 0, ["7"])), poses=3, images=9)
    assert not {"randomised", "completed"} & json_value(asked).keys()
    assert json_value(replace(asked, randomised=True))["randomised"] is True


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda row: row.pop("accepted"), "'accepted' is missing"),
        (lambda row: row["phases_s"].update(settle=1.0), "has the unknown phase settle"),
        (lambda row: row["re"].pop("std_deg"), "'re.std_deg' is missing"),
        (
            lambda row: row.update(bench_ss=row.pop("bench_s")),
            "'bench_ss' is a key that this version does not know (did you mean 'bench_s'?), column ",
        ),
        (lambda row: row["re"].update(p99_deg=1.0), "'re.p99_deg' is a key that"),
        (lambda row: row.update(number="3"), "'number' must be a whole number, found '3'"),
        (lambda row: row.update(simulated=1), "'simulated' must be true or false, found 1"),
        (lambda row: row.update(outcome="flown"), "'outcome' must be 'slipped'"),
        (lambda row: row.update(frames={"D1": 3.5}), "'frames.D1' must be a whole number"),
        (lambda row: row.update(phases_s={"D": 1.0}), "has no phase reference, A, B, C, lower"),
        (lambda row: row.update(accepted=False), "'outcome' slipped contradicts 'accepted' or 'fault'"),
        (lambda row: row.update(fault="lost"), "'outcome' slipped contradicts 'accepted' or 'fault'"),
        (
            lambda row: row.update(accepted=False, outcome="fault", fault="lost"),
            "'final_estimate_deg' is a key that",
        ),
        (lambda row: row.update(angles={}), "'angles' must be null"),
    ],
)
def test_invalid_row_is_reported_with_file_line_and_key(
    lift_row: MakeRow, tmp_path: Path, spoil: Callable[[dict[str, Any]], object], said: str
) -> None:
    row = json_value(lift_row(2))
    spoil(row)
    (tmp_path / "lifts.jsonl").write_bytes(json_line(lift_row(1)) + json.dumps(row).encode() + b"\n")
    with pytest.raises(SessionError) as raised:
        read_lifts(tmp_path)
    assert f"{tmp_path}/lifts.jsonl: line 2 is damaged: " in str(raised.value)
    assert said in str(raised.value)
    rows, damaged = readable_rows(tmp_path / "lifts.jsonl", LIFTS)
    assert (rows, list(damaged)) == ([lift_row(1)], [2])


def test_invalid_line_is_named(tmp_path: Path) -> None:
    for text in (b"null", b"[]", b"7", b'"row"', b"{", b"\xff\xfe", b"[" * 100_000, b"1" * 6000):
        (tmp_path / "lifts.jsonl").write_bytes(text + b"\n")
        with pytest.raises(SessionError, match="line 1 is damaged"):
            read_lifts(tmp_path)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda m: m.pop("seed"), "'seed' is missing"),
        (lambda m: m.update(colour="red"), "'colour' is a key that this version does not know"),
        (
            lambda m: m["config"]["arm"].update(driverr=m["config"]["arm"].pop("driver")),
            "'config.arm.driver' is missing: write 'fake' or 'ur5e'",
        ),
        (
            lambda m: m["config"]["arm"].update(home=m["config"]["arm"].pop("home_m")),
            "'config.arm.home' is a key that this version does not know (did you mean 'home_m'?), column ",
        ),
        (lambda m: m.update(signs={"T1": "left"}), "'signs.T1' must be 1 or -1"),
        (lambda m: m.update(kind="dream"), "a 'dream' session; this version reads trial, record, replay"),
        (lambda m: m.pop("kind"), "a None session"),
        (lambda m: m.pop("schema_version"), "'schema_version' is missing"),
        (
            lambda m: m.update(schema_version=99),
            "schema version 99, this version reads 2; use the version or ",
        ),
        (lambda m: m.update(schema_version=1), "or commit that wrote it: version 0.1.0 at 2026-"),
        (lambda m: m.update(kind=["trial"]), "'kind' must be text"),
    ],
)
def test_invalid_manifest_is_reported_with_its_key(
    drawn_trial: Any, tmp_path: Path, spoil: Callable[[dict[str, Any]], object], said: str
) -> None:
    folder = drawn_trial(tmp_path / "s", (12.0,))
    manifest = json.loads((folder / "session.json").read_text())
    spoil(manifest)
    (folder / "session.json").write_text(json.dumps(manifest))
    with pytest.raises(SessionError, match=r"session\.json: ") as raised:
        read_manifest(folder)
    assert said in str(raised.value)


def test_session_of_another_kind_is_rejected_in_one_sentence(drawn_recording: Any, tmp_path: Path) -> None:
    folder = drawn_recording(tmp_path / "s")
    with pytest.raises(SessionError, match=r"is a 'record' session; only trials have wings"):
        read_manifest_of(folder, TrialManifest, "only trials have wings")
    with pytest.raises(SessionError, match="there is no such session folder"):
        read_manifest_of(tmp_path / "none", TrialManifest, "")
