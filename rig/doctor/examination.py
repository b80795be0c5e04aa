"""The examination of `rig doctor`: every device of a bench, and the computer."""

import importlib
import os
import shutil
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from drivers.errors import CalibrationError, DeviceError, InputError, RecordingError
from rig.bench.findings import Finding, Severity, assess
from rig.bench.source import reserve_bench, unconnected_bench
from rig.config import BenchConfig
from rig.config.calibrations import find_calibrations
from rig.config.extras import pip_line
from rig.config.parts import lacking, working
from rig.doctor.actuators import look_at_arm, look_at_gripper
from rig.doctor.streams import look_at_streams
from rig.terminal.screen import begin_phase

PACKAGES = ("rig", "drivers", "fakes", "calibration", "protocols")
CAMPAIGN_BYTES = 3_000_000_000
"""A campaign of 45 lifts takes at most 3 GB (contract)."""
PROBE_BYTES = 32 * 2**20
"""Bytes written to measure the disk's rate."""
LEAST_MB_S = 20.0
"""Four times the data rate of two DIGITs at 60 and a camera at 30 frames per second, about 5 MB/s."""


def look_at_disk(folder: Path) -> list[Finding]:
    """Measure the sustained write rate of a folder's disk, and its free space.

    Raises `InputError` if the folder is not writable.
    """
    probe = folder / f".rig-doctor-{os.getpid()}"
    block = os.urandom(2**20)
    began = time.perf_counter()
    try:
        with probe.open("wb") as stream:
            for _ in range(PROBE_BYTES // len(block)):
                stream.write(block)
            stream.flush()
            os.fsync(stream.fileno())
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise InputError(f"{folder}: cannot be written ({error.strerror}); give another --disk") from error
    finally:
        probe.unlink(missing_ok=True)
    rate = PROBE_BYTES / 1e6 / (time.perf_counter() - began)
    seen = f"{rate:.0f} MB/s sustained in {folder.resolve()}"
    slow = f"lifts need up to 5 MB/s, and {LEAST_MB_S:g} for a safe margin: keep sessions on a local disk"
    full = f"45 lifts take up to {CAMPAIGN_BYTES / 1e9:g} GB: make room"
    free_text, figures = f"{free / 1e9:.1f} GB free", {"free_gb": free / 1e9}
    return [
        assess("disk", "speed", rate >= LEAST_MB_S, seen, slow, {"written_mb_s": rate}),
        assess("disk", "free space", free >= CAMPAIGN_BYTES, free_text, full, figures),
    ]


def look_at_packages(config: BenchConfig) -> list[Finding]:
    """Check that the rig's packages come from one installation and that the needed libraries exist."""
    parents = {Path(importlib.import_module(name).__file__ or "").parents[1] for name in PACKAGES}
    findings = []
    if len(parents) > 1:
        listed = ", ".join(sorted(map(str, parents)))
        todo = "another distribution overwrote a package of ours: install into a separate environment"
        findings.append(Finding("computer", "packages", Severity.FAILURE, f"from {listed}", todo))
    needed = {"ur5e": "ur-rtde", "robotiq_3f": "pymodbus", "digit": "opencv-contrib-python-headless"}
    versions = {library: _version(library) for driver, library in needed.items() if driver in config.drivers}
    missing = [library for library, found in versions.items() if found is None]
    text = ", ".join(f"{library} {found or 'missing'}" for library, found in versions.items())
    python = f"Python {sys.version.split()[0]}, {os.cpu_count()} cores"
    seen = f"{python}{', ' + text if text else ''}"
    todo = f"{pip_line('bench')} (ur-rtde: with Python 3.12 on Linux x86-64, or from source)"
    software = assess("computer", "software", not missing, seen, todo, otherwise=Severity.FAILURE)
    return [*findings, software]


def _version(library: str) -> str | None:
    try:
        return version(library)
    except PackageNotFoundError:
        return None


def look_at_parts(config: BenchConfig) -> list[Finding]:
    """Report what a trial lacks, and which devices of a bench are simulated beside real ones."""
    findings, works = [], f"no trial is possible; these commands work: {', '.join(working(config))}"
    if missing := lacking(config, "rig trial"):
        findings.append(Finding("bench", "parts", Severity.NOTE, f"has no {', '.join(missing)}", works))
    if config.mixed:
        seen = f"simulated: {', '.join(config.fake_devices)}; real: {', '.join(config.real_devices)}"
        findings.append(Finding("bench", "kinds", Severity.NOTE, seen, works))
    return findings


def look_at_usb(places: Mapping[str, str]) -> list[Finding]:
    """Report the sensors on each USB bus: on a shared bus, the camera that is opened last fails first.

    places: "BUS port PORT" by serial, as drivers identify their devices; empty if not on USB.
    """
    on_bus: dict[str, list[str]] = {}
    for serial, place in places.items():
        bus, _, port = place.partition(" port ")
        if bus:
            on_bus.setdefault(bus, []).append(f"{serial} at {port}")
    advice = (
        "one bus for several cameras: if frames are missing or the last camera does not open, plug one "
        "into another host controller (a hub does not help)"
    )
    return [
        Finding(
            f"USB {bus}", "topology", Severity.NOTE, ", ".join(sharing), advice if len(sharing) > 1 else ""
        )
        for bus, sharing in sorted(on_bus.items())
    ]


def look_at_calibrations(folder: Path, config: BenchConfig) -> list[Finding]:
    """Report the calibrations beside the bench file: age, device, and whether trials accept them."""
    files = sorted(folder.glob("*.yaml")) if folder.is_dir() else []
    if not files:
        seen = f"none in {folder}: the bench file's own values are used"
        advice = "rig calibrate measures what this bench has: see docs/calibrating.md"
        return [Finding("calibration", "files", Severity.NOTE, seen, advice)]
    # the gripper's table is stored under the bench's name, the arm's clock under "arm"
    serials = {*(sensor.serial for sensor in config.sensors), config.name, "arm"}
    findings = [_calibration(path, serials) for path in files]
    remarks: list[str] = []
    try:
        find_calibrations(config, folder, remarks.append)
    except CalibrationError as error:
        seen, _, todo = str(error).partition("; ")
        findings.append(Finding("calibration", "in trials", Severity.FAILURE, seen, todo))
    return [*findings, *(Finding("calibration", "in trials", Severity.NOTE, remark) for remark in remarks)]


def _calibration(path: Path, serials: set[str]) -> Finding:
    from calibration.store import OLD_DAYS, age_days, age_text, load, read_yaml

    try:
        about = read_yaml(path).get("calibration")
        kind = about.get("kind", "") if isinstance(about, dict) else ""
        file = load(path, kind, allow_refused=True)
    except CalibrationError as error:
        seen, _, todo = str(error).partition("; ")
        return Finding("calibration", path.name, Severity.WARNING, seen, todo)
    now = datetime.now(UTC)
    days = age_days(file.created, now)
    strangers = sorted(set(file.serials.values()) - serials)
    severity, todo = Severity.GOOD, ""
    if days > OLD_DAYS:
        severity, todo = Severity.WARNING, f"older than {OLD_DAYS:g} days: check it with rig calibrate"
    if strangers:
        severity, todo = Severity.WARNING, f"of {', '.join(strangers)}, which this bench does not have"
    return Finding("calibration", file.kind, severity, age_text(days), todo, {"age_days": days})


def examine(
    config: BenchConfig, bench_folder: Path, disk: Path, duration_s: float = 3.0, snapshot: Path | None = None
) -> Iterator[Finding]:
    """Run all checks and yield findings as they are made; nothing moves, nothing is activated.

    bench_folder: folder of the bench file, with its `calibrations`. disk: a folder for sessions. duration_s:
    of each rate measurement. snapshot: see `rig doctor`.
    """
    yield from look_at_packages(config)
    yield from look_at_parts(config)
    begin_phase("writing to the disk")
    yield from look_at_disk(disk)
    yield from look_at_calibrations(bench_folder / "calibrations", config)
    with ExitStack() as connected:
        try:
            connected.enter_context(reserve_bench(config))
        except (DeviceError, RecordingError) as error:
            seen, _, todo = str(error).partition("; ")
            yield Finding("bench", "use", Severity.FAILURE, seen, todo)
            return
        bench = connected.enter_context(unconnected_bench(config))
        for device in (*bench.frame_sources, *bench.actuators):
            connected.callback(device.disconnect)
        if bench.has("arm"):
            begin_phase("reading the arm")
            yield from look_at_arm(bench, config.require("arm"), duration_s)
        if bench.has("gripper"):
            begin_phase("reading the gripper")
            yield from look_at_gripper(bench, duration_s)
        begin_phase("reading the fingertips and the camera")
        sizes_px = {sensor.serial: sensor.size_px for sensor in config.sensors}
        yield from look_at_streams(bench.frame_sources, bench.clock, sizes_px, duration_s, snapshot)
        yield from look_at_usb({s.serial: s.identity().get("usb", "") for s in bench.frame_sources})
