"""The whole examination: every device of a bench, and the computer it hangs on."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

from drivers.bench import Bench
from rig.bench.source import unconnected_bench
from rig.config import BenchConfig
from rig.doctor.actuators import look_at_arm, look_at_gripper
from rig.doctor.computer import (
    look_at_calibrations,
    look_at_disk,
    look_at_packages,
    look_at_usb,
)
from rig.doctor.finding import Finding
from rig.doctor.streams import look_at_streams
from rig.live.phases import begin_phase


def examine(
    config: BenchConfig, bench_folder: Path, disk: Path, duration_s: float = 3.0, snapshot: Path | None = None
) -> Iterator[Finding]:
    """Look at everything and yield findings as they come; nothing moves, nothing is activated.

    bench_folder: where the bench file lies, with its `calibrations` beside it. disk: a folder
    where sessions go. duration_s: of each measurement of a rate. snapshot: see `rig doctor`.
    """
    yield from look_at_packages(config)
    begin_phase("writing to the disk")
    yield from look_at_disk(disk)
    # a gripper's table goes by the bench's name, and the arm's clock by "arm"
    serials = {*(tactile.serial for tactile in config.tactile), config.camera.serial, config.name, "arm"}
    yield from look_at_calibrations(bench_folder / "calibrations", serials)
    with unconnected_bench(config) as bench, ExitStack() as connected:
        for device in (*bench.frame_sources, bench.gripper, bench.arm):
            connected.callback(device.disconnect)
        begin_phase("reading the arm")
        yield from look_at_arm(bench, config.arm, duration_s)
        begin_phase("reading the gripper")
        yield from look_at_gripper(bench, duration_s)
        begin_phase("reading the fingertips and the camera")
        yield from look_at_streams(bench.frame_sources, bench.clock, _sizes(config), duration_s, snapshot)
        yield from look_at_usb(_usb_places(bench))


def _sizes(config: BenchConfig) -> dict[str, tuple[int, int]]:
    return {sensor.serial: sensor.size_px for sensor in (*config.tactile, config.camera)}


def _usb_places(bench: Bench) -> dict[str, str]:
    """Where on USB the sensors were found, by serial, where their drivers say."""
    return {source.serial: source.identity().get("usb", "") for source in bench.frame_sources}
