"""The findings of `rig doctor`: measurements, verdicts and advice."""

from pathlib import Path

import numpy as np
import pytest

from drivers.errors import DeviceError, InputError
from rig.bench.assembly import build_bench
from rig.bench.findings import Finding, Severity
from rig.bench.source import reserve_bench
from rig.config import BenchConfig, load_bench
from rig.doctor.actuators import look_at_arm, look_at_gripper
from rig.doctor.examination import examine, look_at_calibrations, look_at_disk, look_at_usb
from rig.doctor.finding import percentiles_ms
from rig.doctor.streams import look_at_streams
from support.benches import real_bench_file


def bench_with(*faults: dict[str, object]) -> BenchConfig:
    return BenchConfig.model_validate({**load_bench("fake").model_dump(), "faults": faults})


def find(findings: list[Finding], device: str, check: str) -> Finding:
    return next(f for f in findings if (f.device, f.check) == (device, check))


def looked_at_streams(
    config: BenchConfig, snapshot: Path | None = None, sizes: dict[str, tuple[int, int]] | None = None
) -> list[Finding]:
    bench, _ = build_bench(config)
    stated = {s.serial: s.size_px for s in (*config.tactile, config.camera)} | (sizes or {})
    return look_at_streams(bench.frame_sources, bench.clock, stated, 0.5, snapshot)


def test_percentiles_are_in_ms() -> None:
    figures = percentiles_ms(np.linspace(0.0, 0.1, 101))
    assert figures == pytest.approx({"p50_ms": 50.0, "p95_ms": 95.0, "p99_ms": 99.0, "max_ms": 100.0})


def test_real_rates_are_measured_and_a_frame_of_each_is_saved(tmp_path: Path) -> None:
    findings = looked_at_streams(load_bench("fake"), tmp_path / "today")
    rate = find(findings, "SIM-D0001", "frames").figures["rate_hz"]
    assert isinstance(rate, float)
    assert 50 < rate < 70
    assert find(findings, "SIM-C0001", "picture").figures["width_px"] == 640
    names = {path.name for path in (tmp_path / "today").iterdir()}
    assert names == {"SIM-D0001.png", "SIM-D0002.png", "SIM-C0001.png"}


def test_missed_frames_dead_sensor_and_wrong_size_are_distinguished() -> None:
    config = bench_with(
        {"device": "SIM-D0001", "kind": "drop", "at_s": 0.2, "duration_s": 0.1},
        {"device": "SIM-D0002", "kind": "disconnect", "at_s": 0.0},
    )
    findings = looked_at_streams(config, sizes={"SIM-C0001": (1280, 720)})
    missing = find(findings, "SIM-D0001", "frames")
    assert missing.verdict is Severity.WARNING
    assert missing.figures["missed"]
    assert "USB controller" in missing.todo
    dead = find(findings, "SIM-D0002", "reached")
    assert dead.verdict is Severity.FAILURE
    assert dead.todo.startswith("check its cable")
    assert "1280 x 720" in find(findings, "SIM-C0001", "picture").todo


def test_mode_and_force_sensor_of_the_arm_are_checked_without_activation() -> None:
    config = bench_with({"device": "arm", "kind": "protective_stop", "at_s": 0.0})
    bench, _ = build_bench(config)
    findings = look_at_arm(bench, config.arm, 0.1)
    without = config.arm.model_copy(update={"force_sensor": False})
    sensor = find(look_at_arm(bench, without, 0.1), "arm", "force sensor")
    assert sensor.verdict is Severity.WARNING
    assert "not guarded" in sensor.todo
    mode = find(findings, "arm", "mode")
    assert mode.verdict is Severity.FAILURE
    assert "look at the arm" in mode.todo
    assert find(look_at_gripper(bench, 0.1), "gripper", "state").verdict is Severity.NOTE
    assert not bench.gripper.state().activated


def test_unresponsive_device_is_reported_and_checks_continue() -> None:
    bench, _ = build_bench(load_bench("fake"))

    def refuse() -> None:
        raise DeviceError("arm: nobody at 192.0.2.1; check the cable")

    bench.arm.connect = refuse  # type: ignore[method-assign]
    (finding,) = look_at_arm(bench, load_bench("fake").arm, 0.1)
    assert (finding.verdict, finding.seen, finding.todo) == (
        Severity.FAILURE, "nobody at 192.0.2.1", "check the cable",
    )  # fmt: skip


def test_disk_check_leaves_no_files(tmp_path: Path) -> None:
    speed, free = look_at_disk(tmp_path)
    assert speed.figures["written_mb_s"]
    assert free.figures["free_gb"]
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError, match="--disk"):
        look_at_disk(tmp_path / "nowhere")


def test_cameras_on_one_usb_bus_and_missing_calibrations_are_named(tmp_path: Path) -> None:
    places = {"D1": "usb1 port 1-2.4", "D2": "usb1 port 1-2.3", "C1": "usb3 port 3-1", "X": ""}
    shared, alone = look_at_usb(places)
    assert (shared.device, shared.seen) == ("USB usb1", "D1 at 1-2.4, D2 at 1-2.3")
    assert "another host controller" in shared.todo
    assert alone.todo == ""
    (finding,) = look_at_calibrations(tmp_path / "calibrations", set())
    assert (finding.verdict, "none" in finding.seen) == (Severity.NOTE, True)


def test_devices_that_another_program_uses_are_not_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    bench = load_bench(real_bench_file(tmp_path))
    with reserve_bench(bench):
        *_, last = examine(bench, tmp_path, tmp_path)
    assert (last.device, last.verdict) == ("bench", Severity.FAILURE)
    assert "another rig program uses this bench" in last.seen
