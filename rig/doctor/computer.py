"""The doctor's look at this computer: disk, packages, USB topology, calibration files."""

import importlib
import os
import shutil
import sys
import time
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from drivers.errors import CalibrationError, InputError
from rig.config import BenchConfig
from rig.doctor.finding import Finding, Severity

PACKAGES = ("rig", "drivers", "fakes", "calibration", "protocols")
CAMPAIGN_BYTES = 3_000_000_000
"""A campaign of 45 lifts takes at most 3 GB (contract)."""
PROBE_BYTES = 32 * 2**20
LEAST_MB_S = 20.0
"""Two DIGITs at 60 and a camera at 30 frames a second make about 5 MB/s; four times that is ease."""
OLD_DAYS = 30.0


def look_at_disk(folder: Path) -> list[Finding]:
    """Measure how fast a folder's disk takes data for good, and how much room is left.

    Raises `InputError` when nothing can be written there.
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
    slow, full = rate < LEAST_MB_S, free < CAMPAIGN_BYTES
    return [
        Finding(
            "disk",
            "speed",
            Severity.WARNING if slow else Severity.GOOD,
            f"{rate:.0f} MB/s for good in {folder.resolve()}",
            f"lifts need up to 5 MB/s, with ease {LEAST_MB_S:g}: keep sessions on a local disk"
            if slow
            else "",
            {"written_mb_s": rate},
        ),
        Finding(
            "disk",
            "free space",
            Severity.WARNING if full else Severity.GOOD,
            f"{free / 1e9:.1f} GB free",
            f"45 lifts take up to {CAMPAIGN_BYTES / 1e9:g} GB: make room" if full else "",
            {"free_gb": free / 1e9},
        ),
    ]


def look_at_packages(config: BenchConfig) -> list[Finding]:
    """Check that our packages are ours, and that the libraries this bench needs are installed."""
    parents = {Path(importlib.import_module(name).__file__ or "").parents[1] for name in PACKAGES}
    findings = []
    if len(parents) > 1:
        listed = ", ".join(sorted(map(str, parents)))
        todo = "another distribution overwrote a package of ours: install into an environment of its own"
        findings.append(Finding("computer", "packages", Severity.FAILURE, f"from {listed}", todo))
    needed = {"ur5e": "ur-rtde", "robotiq_3f": "pymodbus", "digit": "opencv-contrib-python-headless"}
    versions = {library: _version(library) for driver, library in needed.items() if driver in config.drivers}
    missing = [library for library, found in versions.items() if found is None]
    text = ", ".join(f"{library} {found or 'missing'}" for library, found in versions.items())
    python = f"Python {sys.version.split()[0]}, {os.cpu_count()} cores"
    findings.append(
        Finding(
            "computer",
            "software",
            Severity.FAILURE if missing else Severity.GOOD,
            f"{python}{', ' + text if text else ''}",
            f"pip install {' '.join(missing)} (ur-rtde: Linux x86-64, Python 3.11 or 3.12)"
            if missing
            else "",
        )
    )
    return findings


def _version(library: str) -> str | None:
    try:
        return version(library)
    except PackageNotFoundError:
        return None


def look_at_usb(places: Mapping[str, str]) -> list[Finding]:
    """Say who shares a USB bus: there the last camera to be opened fails first.

    places: "BUS port PORT" by serial, as drivers identify their devices; empty where not on USB.
    """
    on_bus: dict[str, list[str]] = {}
    for serial, place in places.items():
        bus, _, port = place.partition(" port ")
        if bus:
            on_bus.setdefault(bus, []).append(f"{serial} at {port}")
    advice = (
        "one bus for several cameras: where frames are missing or the last one does not open, plug one "
        "into another host controller (a hub does not help)"
    )
    return [
        Finding(
            f"USB {bus}", "topology", Severity.NOTE, ", ".join(sharing), advice if len(sharing) > 1 else ""
        )
        for bus, sharing in sorted(on_bus.items())
    ]


def look_at_calibrations(folder: Path, serials: set[str]) -> list[Finding]:
    """Say what calibrations lie beside the bench file, how old they are, and whose."""
    files = sorted(folder.glob("*.yaml")) if folder.is_dir() else []
    if not files:
        seen = f"none in {folder}: the numbers of the bench file are used as they are"
        return [
            Finding(
                "calibration", "files", Severity.NOTE, seen, "measure the camera's place and focal length"
            )
        ]
    return [_calibration(path, serials) for path in files]


def _calibration(path: Path, serials: set[str]) -> Finding:
    from calibration.store import age_days, age_text, load, read_yaml

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
    verdict, todo = Severity.GOOD, ""
    if days > OLD_DAYS:
        verdict, todo = Severity.WARNING, f"older than {OLD_DAYS:g} days: check it with rig calibrate"
    if strangers:
        verdict, todo = Severity.WARNING, f"of {', '.join(strangers)}, which this bench does not have"
    return Finding("calibration", file.kind, verdict, f"{age_text(days)} old", todo, {"age_days": days})
