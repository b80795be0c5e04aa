"""Lifts with the real drivers on fakes over the wire protocols, in slow motion."""

import json
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from rig.bench.fakes_process import started_fakes
from rig.benchmark.wire.lift import WireLift, judge_wire, measure_wire
from rig.config import BenchConfig
from rig.config.objects import new_object_file
from rig.config.write import write_bench
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.sessions.records import LiftOutcome
from rig.sessions.rows import read_finished_lifts
from support.command_line import answer, refusal, rig
from support.quick_lifts import STORED_TRIAL
from support.slow_motion import IN_SLOW_MOTION, SLOWNESS, slow_down
from support.waiting import LIMIT_S


def test_wire_lift_measures_the_slip_and_loses_no_frame(
    tmp_path: Path, unhurried_bench: BenchConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow_down(monkeypatch, "rig.benchmark.wire.campaign")
    for phase in ("GRASP_S", "HOLD_S"):
        monkeypatch.setattr(f"protocols.slip_trial.{phase}", 0.5)
    lift = measure_wire(tmp_path / "s", "t1", seeds=0, bench=unhurried_bench)
    assert {stream.serial for stream in lift.streams} == {"SIM-D0001", "SIM-D0002", "SIM-C0001"}
    assert sum(stream.missing for stream in lift.streams) == 0, lift.streams
    assert min(stream.recorded for stream in lift.streams) > 100
    assert lift.row.simulated is True
    assert lift.row.outcome is LiftOutcome.SLIPPED
    assert abs(lift.row.final_truth_deg) > 5.0
    assert lift.row.re_b.mean_deg < 1.0
    manifest = read_manifest_of(tmp_path / "s", TrialManifest, "no trial")
    assert (manifest.bench, manifest.simulated) == ("wire", True)


def test_wire_lift_is_compared_with_the_same_lift_in_process() -> None:
    (row,) = read_finished_lifts(STORED_TRIAL)
    other = replace(row, re_b=replace(row.re_b, mean_deg=row.re_b.mean_deg + 0.1))
    same = WireLift((), state_hz=499.0, controller_core=0.1, wall_s=1.0, row=row, seeds=(row, other))
    assert all(limit.met for limit in judge_wire(same))
    turned = replace(row, final_truth_deg=row.final_truth_deg + 2.0)
    fallen = replace(row, outcome=LiftOutcome.FALLEN)
    wrong = replace(row, re_b=replace(row.re_b, mean_deg=row.re_b.mean_deg + 5.0))
    for different in (turned, fallen, wrong):
        missed = [limit for limit in judge_wire(replace(same, row=different)) if not limit.met]
        assert len(missed) == 1


@pytest.mark.heavy
def test_new_object_is_taught_and_recorded(
    tmp_path: Path, unhurried_bench: BenchConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    slow_down(monkeypatch)
    monkeypatch.setattr("rig.bench.fakes_process.LED_S", 1.5)
    (tmp_path / "objects").mkdir()
    new_object_file(tmp_path / "objects" / "lever.toml")
    with started_fakes(unhurried_bench, SLOWNESS) as served:
        write_bench(tmp_path / "bench.toml", served)
        bench = ("--bench", tmp_path / "bench.toml", "--json")
        taught = rig("teach", "lever", *bench, "--yes")
        poses = ("--poses", 1, "--images", 4, "--no-report", "--out", tmp_path / "poses")
        recorded = rig("record", "--object", "lever", *poses, *bench)
    assert taught.returncode == 0, taught.stderr
    (found,) = json.loads(taught.stdout)["positions"]
    assert found["problems"] == []
    assert (found["offset_m"], found["height_m"]) == pytest.approx((0.03, 0.0), abs=0.005)
    assert found["width_m"] == pytest.approx(0.03, abs=0.003)
    assert json.loads(recorded.stdout)["poses_accepted"] == 1, recorded.stderr


@pytest.mark.heavy
def test_doctor_reads_everything_but_the_arm_without_ur_rtde() -> None:
    code = f"""{IN_SLOW_MOTION}if True:
        import sys
        sys.modules.update(rtde_control=None, rtde_receive=None)
        from rig.bench.source import unconnected_bench
        from rig.config import load_bench
        from rig.doctor.actuators import look_at_arm, look_at_gripper
        from rig.doctor.streams import look_at_streams
        config = load_bench("wire")
        sizes = dict((s.serial, s.size_px) for s in (*config.tactile, config.camera))
        with unconnected_bench(config) as bench:
            findings = look_at_arm(bench, config.arm, 0.5) + look_at_gripper(bench, 0.5)
            findings += look_at_streams(bench.frame_sources, bench.clock, sizes, 0.5, None)
            for device in (*bench.frame_sources, bench.gripper, bench.arm):
                device.disconnect()
        for f in findings:
            print(f.device, f.check, f.verdict, f.seen)
    """
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    lines = done.stdout.splitlines()
    assert any(line.startswith("arm reached failure") and "ur-rtde" in line for line in lines), done.stderr
    for device in ("gripper", "SIM-D0001", "SIM-D0002", "SIM-C0001"):
        assert any(line.startswith(f"{device} reached good") for line in lines), lines


@pytest.mark.heavy
def test_served_fakes_print_a_bench_file_execute_commands_and_end_cleanly(tmp_path: Path) -> None:
    file = tmp_path / "fakes.toml"
    command = [sys.executable, "-m", "rig", "fakes", "serve", "--host", "127.0.0.61", "--write", str(file)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        lines = iter(process.stderr.readline, "")
        assert any(line.startswith("SIMULATED devices are served") for line in lines)
        (tmp_path / "objects").mkdir()
        assert rig("fakes", "place", "wrench", "--bench", file).returncode == 0
        status = rig("fakes", "status", "--bench", file, "--json")
        assert json.loads(status.stdout)["object"] == "t1"
        assert rig("objects", "new", tmp_path / "objects" / "lever.toml").returncode == 0
        assert rig("fakes", "place", "lever", "--bench", file).returncode == 0, "it lies beside the file"
        assert answer("fakes", "status", "--bench", file)["object"] == "lever"
        assert "protective_stop" in refusal("fakes", "fault", "arm", "hiccup", "--bench", file)
    finally:
        process.send_signal(signal.SIGINT)
        out, _ = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0
    assert out == file.read_text() + "\n"
