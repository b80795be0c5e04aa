"""`rig calibrate sync`: time offsets between streams that recorded one motion, from tables or on a bench.

On a bench an object with markers is moved. The arm wiggles it and is the reference; without an arm, a person
turns it by hand, and the camera is.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.markers.tracker import MarkerTracker
from calibration.store import read_yaml, write_bytes
from calibration.targets.aruco import Refusal
from calibration.time_offset import time_offset
from calibration.verdict import Assessment
from drivers.clock import NS_PER_S
from drivers.errors import CalibrationError, InputError, plural
from drivers.formats import read_text
from drivers.interfaces import Arm
from drivers.progress import steps
from drivers.types import ArmState, Frame
from protocols.capture_touch import Stroke, Touch, capture_turning_by_hand, capture_wiggle
from protocols.grasps import find_grasp_file
from protocols.observer import Phase
from rig.bench.twins import refuse_undrawn
from rig.calibrate import charts
from rig.calibrate.bench import Station, TouchObserver, grasp_at, touch_motions
from rig.calibrate.kind import Differences, Kind, ObjectsFolder, Samples
from rig.calibrate.result import CalibrationResult, Figure
from rig.calibrate.samples import read_stream, write_table
from rig.config import BenchConfig
from rig.declared import option
from rig.frames.times import USUAL_FPS, ask_unit

ARM = "arm"
"""The stream whose clock is the reference."""
REFERENCE_FILE = "reference.txt"
"""File in the folder of recorded streams with the name of the reference stream."""
_KNOWN_REFERENCES = ("robot", ARM)
_HEIGHTS_M = (0.002, 0.014)
_SPEEDS_M_S = (0.02, 0.09)
_LONGEST_NAME = 1000
_STROKES = 36
_SMALL = (24, 32)
MOST_LAG_S, LAG_STEP_S = 0.5, 0.01
"""Lags at which the patterns of a gel are compared with the markers' angle, as `--search` by default."""
_FIRM_M = 0.0037
"""Closing past contact, m, six steps of a Robotiq 3-Finger: holds a block at its middle without slip."""


@dataclass(frozen=True)
class SyncOptions:
    """Estimate the time offset and drift between streams that measured the same motion.

    On a bench the arm moves an object with markers up and down by 1 cm. The offsets of the camera and of both
    fingertips from the arm's clock are estimated. If the bench lacks an arm, a gripper or the second
    fingertip, nothing moves: you press the object onto the gel and turn it to and fro by hand, and the
    offsets of the fingertips from the camera's clock are estimated.

    The folder of --from holds <name>.csv for each stream. By default each stream is compared with the
    reference: the one named in reference.txt, as the rig writes it, otherwise robot or arm. The columns are
    time_ns (or t_s) and value, any quantity that changes with the motion. Its unit does not matter and may
    differ between the streams, since only the time offset is estimated. Long, fast and irregular motions
    give the best results. Instead of value the columns may be an orientation, qx, qy, qz, qw. Then the
    turning speeds are compared, which are equal for two sensors on one rigid body.

    Examples:
      rig calibrate sync --bench fake
      rig calibrate sync --from calibrations/sync-samples
      rig calibrate sync --from wiggle --reference robot --stream camera
    """

    first: str | None = option(None, "With --from: stream whose clock is the reference.", "--reference")
    second: str | None = option(
        None, "With --from: stream whose offset is estimated. Default: all others.", "--stream"
    )
    search: float = option(0.5, "Largest offset to search for, s.", min=0.01, max=10)
    object_name: str = option(
        "gauge:30", "On a bench: object with the markers, or gauge:WIDTH for a block (mm).", "--object"
    )
    objects: ObjectsFolder = None


def solve_streams(samples: Samples, options: SyncOptions) -> list[CalibrationResult]:
    """Return the offset of each chosen stream of a folder from its reference. Raises `InputError`."""
    folder = samples.folder
    names = sorted(path.stem for path in folder.glob("*.csv"))
    first = options.first or _stored_reference(folder, names)
    seconds = [options.second] if options.second else [name for name in names if name != first]
    missing = next((f"{folder / name}.csv" for name in (first, *seconds) if name not in names), None)
    if missing or not seconds:
        problem = f"there is no {missing}" if missing else f"{folder}: there is no stream beside {first}"
        raise InputError(f"{problem}: {_list_streams(names)}")
    return [solve_pair(folder, first, second, options.search) for second in seconds]


def _stored_reference(folder: Path, names: Sequence[str]) -> str:
    """Return the name of the reference stream of a folder. Raises `InputError` if it is unknown."""
    stored = folder / REFERENCE_FILE
    if stored.is_file():
        return read_text(stored, _LONGEST_NAME).strip()
    found = next((name for name in _KNOWN_REFERENCES if name in names), None)
    if found is None:
        raise InputError(f"{folder}: which stream is the reference? {_list_streams(names)}")
    return found


def _list_streams(names: Sequence[str]) -> str:
    found = (
        f"this folder has {', '.join(f'{name}.csv' for name in names[:6])}" if names else "it has no CSV file"
    )
    return f"{found}; give --reference and --stream (names without .csv)"


def solve_pair(folder: Path, first: str, second: str, search_s: float = 0.5) -> CalibrationResult:
    """Find the offset of two CSV files of one motion, `<name>.csv` with time_ns (or t_s) and value.

    first, second: names of the reference and of the other stream. search_s: largest offset.
    """
    paths = [folder / f"{name}.csv" for name in (first, second)]
    one, other = (read_stream(path) for path in paths)
    found = time_offset(one, other, search_s)
    steps_s = [float(np.median(np.diff(stream.time_ns))) / NS_PER_S for stream in (one, other)]
    if max(steps_s) < 1.0 / USUAL_FPS[1]:
        rate = f"both streams have more than {USUAL_FPS[1]:.0f} samples a second by their times"
        doubt = Assessment(doubts=(f"{rate}: {ask_unit(max(steps_s))}",))
        found = replace(found, assessment=found.assessment + doubt)
    layout, pictures = {}, []
    figures = [
        Figure("add_to_stream_s", found.offset_s, "to add to the stream", ".3f", "ms", 1e3,
               sigma=found.sigma_s, top=True),
        Figure("explained", found.explained, "motion explained", ".1f", "%", 100.0),
        Figure("drift_ppm", found.drift_ppm, "drift of the clocks, which the bench does not use", ".2f",
               "ppm", sigma=found.drift_sigma_ppm, top=True),
    ]  # fmt: skip
    if found.offset_s is not None:
        layout = {"reference": first, "stream": second}
        at_s, other_s = ((stream.time_ns - one.time_ns[0]) / NS_PER_S for stream in (one, other))
        moved = other_s + found.offset_s, (other.values - other.values.mean()) / (found.gain or 1.0)
        shown = {first: (at_s, one.values - one.values.mean()), f"{second}, moved": moved}
        text = "The second is shifted by the offset and scaled; both should coincide."
        pictures = [charts.curves("Both streams", text, shown, "time, s", "value without its mean")]
    return CalibrationResult(
        "sync", {"reference": first, "stream": second}, layout, found.assessment, figures,
        source=str(folder), used=found.used, files=paths, pictures=pictures,
    )  # fmt: skip


def collect_streams(station: Station, options: SyncOptions) -> list[CalibrationResult]:
    """Move an object with markers; return each sensor's offset from the arm's clock, or else the camera's.

    Raises `OperatorStopError` unless the operator agrees, `DeviceError`, `InputError`.
    """
    station = station.with_objects(options.objects)
    config = station.config
    touch = _touch(config, options.object_name)
    camera, tips = config.require("camera"), tuple(t.serial for t in config.tactile)
    raw = station.raw("sync", camera.serial, *tips)
    tracker = MarkerTracker(camera.marker_ids, camera.marker_dictionary)
    watch = WiggleObserver(tips, shown=station.show, tracker=tracker, camera=camera.serial)
    by_arm = config.moves and len(tips) > 1
    if by_arm:
        with station.connection(
            f"The arm will hold {touch.name} and move it up and down between {1e3 * _HEIGHTS_M[0]:.0f} and "
            f"{1e3 * _HEIGHTS_M[1]:.0f} mm over the table {_STROKES} times, at up to {_SPEEDS_M_S[1]} m/s.",
            from_home=True,
            motions=touch_motions(config, [touch]),
        ) as (bench, operator):
            watch.arm_device = bench.arm
            capture_wiggle(bench, operator, watch, touch, strokes(station.seed))
            station.note(f"{touch.name}: moved up and down", 1, 1)
    else:
        with station.connection(f"Nothing moves. You turn {touch.name} by hand.") as (bench, operator):
            capture_turning_by_hand(bench, operator, watch, touch)
            station.note(f"{touch.name}: turned by hand", 1, 1)
    for name, (times, values) in watch.streams().items():
        rows = [f"{t},{v:.9g}" for t, v in zip(times.tolist(), values.tolist(), strict=True)]
        write_table(raw / f"{name}.csv", "time_ns,value", rows)
    reference, sensors = (ARM, (camera.serial, *tips)) if by_arm else (camera.serial, tips)
    write_bytes(raw / REFERENCE_FILE, f"{reference}\n".encode())
    return [solve_pair(raw, reference, name, options.search) for name in sensors]


def _touch(config: BenchConfig, name: str) -> Touch:
    """Return a firm grasp of an object: a block ("gauge:30") at its middle, others by their object file."""
    kind, _, size = name.partition(":")
    if kind == "gauge":
        try:
            width_m = float(size) / 1e3
        except ValueError as error:
            raise InputError(f"--object '{name}': give the block's width in mm, as gauge:30") from error
        return Touch(
            "wiggle", name, f"block {size} mm wide with the markers", grasp_at(config), width_m, _FIRM_M
        )
    grasps = find_grasp_file(name, config.objects)
    refuse_undrawn(config, grasps)
    place = min(grasps.position, key=lambda p: abs(p.offset_m))
    pose = grasp_at(config, place.offset_m, place.height_m)
    return Touch("wiggle", grasps.id, grasps.name, pose, place.width_m, grasps.grip_m[1])


def strokes(seed: int) -> list[Stroke]:
    """Return strokes up and down in turn, each to another height at another speed."""
    rng = np.random.default_rng((seed, 34))
    low, high = _HEIGHTS_M
    middle = (low + high) / 2
    return [
        Stroke(
            float(rng.uniform(*((middle + 0.001, high) if i % 2 == 0 else (low, middle - 0.001)))),
            float(rng.uniform(*_SPEEDS_M_S)),
        )
        for i in range(_STROKES)
    ]


@dataclass(slots=True)
class WiggleObserver(TouchObserver):
    """Records each device during the motion: the arm's heights, the markers, small tactile pictures.

    arm_device: None if a person moves the object.
    """

    arm_device: Arm | None = None
    tracker: MarkerTracker | None = None
    camera: str = ""
    _heights: dict[int, float] = field(default_factory=dict)
    _markers: list[tuple[int, float]] = field(default_factory=list)
    _first_corners: NDArray[np.float64] | None = None
    _pictures: dict[str, list[tuple[int, NDArray[np.float32]]]] = field(default_factory=dict)

    def arm(self, state: ArmState) -> None:
        if self.phase_now is Phase.LIFT:
            self._heights[state.time_ns] = state.base_T_tcp.position_m[2]

    def look(self, frame: Frame) -> None:
        """Keep what the markers show of the motion, or a small copy of the tactile picture."""
        if self.phase_now is not Phase.LIFT:
            TouchObserver.look(self, frame)
            return
        if self.arm_device is not None:
            self.arm(self.arm_device.state())
        if frame.serial in self.serials:
            small = cv2.resize(frame.image, _SMALL, interpolation=cv2.INTER_AREA).astype(np.float32)
            self._pictures.setdefault(frame.serial, []).append((frame.time_ns, small))
            return
        grey = np.asarray(cv2.cvtColor(frame.image, cv2.COLOR_RGB2GRAY), np.uint8)
        seen = self.tracker.detect(grey) if self.tracker is not None else Refusal.NOT_FOUND
        if isinstance(seen, Refusal):
            return
        if self._first_corners is None:
            self._first_corners = seen
        # the markers' height (px), or, if turned by hand, their angle since the first frame (rad)
        by_hand = self.arm_device is None
        value = rotation_rad(self._first_corners, seen) if by_hand else float(seen[..., 1].mean())
        self._markers.append((frame.time_ns, value))

    def streams(self) -> dict[str, tuple[NDArray[np.int64], NDArray[np.float64]]]:
        """Return times (ns) and values by stream: the arm's height, and each sensor's change by the wiggle.

        Raises `CalibrationError` where a sensor saw next to nothing.
        """
        found = {self.camera: _series(self._markers)}
        if self.arm_device is not None:
            found[ARM] = _series(sorted(self._heights.items()))
        for serial in self.serials:
            pictures = self._pictures.get(serial, [])
            if len(pictures) < 3:
                raise CalibrationError(
                    f"{serial}: {plural(len(pictures), 'frame')} of the wiggle; does it stream?"
                )
            times = np.array([time_ns for time_ns, _ in pictures], np.int64)
            small = np.array([p.ravel() for _, p in pictures])
            if self.arm_device is not None:
                found[serial] = times, strongest_changes(small, 1)[:, 0]
            else:
                found[serial] = times, most_alike(times, strongest_changes(small, 2), *found[self.camera])
        return found


def strongest_changes(pictures: NDArray[np.float32], count: int) -> NDArray[np.float64]:
    """Return the first principal components of pictures (N, K), (N, count)."""
    centred = pictures - pictures.mean(axis=0)
    u, strengths, _ = np.linalg.svd(centred.astype(np.float64), full_matrices=False)
    return u[:, :count] * strengths[:count]


def most_alike(
    time_ns: NDArray[np.int64],
    changes: NDArray[np.float64],
    reference_ns: NDArray[np.int64],
    reference: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return the weighted sum of changes, (N, k), that is most like a reference at any lag of `MOST_LAG_S`.

    A turned contact changes the picture in two patterns: on the simulated gel the better one has 55 % of the
    motion in common with the markers' angle, both together 99.9 %.
    """
    best, weights = np.inf, np.zeros(changes.shape[1])
    for lag_s in steps(np.arange(-MOST_LAG_S, MOST_LAG_S + LAG_STEP_S / 2, LAG_STEP_S)):
        wanted = np.interp(time_ns + 1e9 * lag_s, reference_ns, reference)
        wanted -= wanted.mean()
        found, *_ = np.linalg.lstsq(changes, wanted, rcond=None)
        left = float(((wanted - changes @ found) ** 2).sum()) / max(float((wanted**2).sum()), 1e-12)
        if left < best:
            best, weights = left, found
    return changes @ weights


def rotation_rad(before: NDArray[np.float64], now: NDArray[np.float64]) -> float:
    """Return the least-squares rotation of points, (..., 2) px, about their centroid, rad."""
    flat = [points.reshape(-1, 2) - points.reshape(-1, 2).mean(axis=0) for points in (before, now)]
    one, other = (points[:, 0] + 1j * points[:, 1] for points in flat)
    return float(np.angle(np.vdot(one, other)))


def _series(pairs: list[tuple[int, float]]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    return np.array([t for t, _ in pairs], np.int64), np.array([v for _, v in pairs], np.float64)


def compare_offsets(one: Path, other: Path) -> Differences:
    """Return how much larger the offset in the second file is."""
    offset_s = [read_yaml(path)["add_to_stream_s"] for path in (one, other)]
    return {"offset_ms": round(1e3 * (offset_s[1] - offset_s[0]), 4)}


SYNC = Kind("sync", SyncOptions, "motions", solve_streams, collect_streams, compare_offsets)
