"""Hand-eye calibration on a bench: poses are chosen and visited, samples kept as files, then solved."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from calibration.camera.model import CameraModel
from calibration.hand_eye.samples import HandEyeSample, Setup
from calibration.hand_eye.solve import calibrate_hand_eye, next_pose
from calibration.targets.boards import Target, View
from calibration.verdict import Rejected
from drivers.errors import counted
from drivers.types import Pose
from protocols.capture_hand_eye import SPEED_M_S, HandEyeCapture, capture_hand_eye
from protocols.readiness import agree_to_carry
from rig.bench.assembly import TOOL_DOWN
from rig.bench.plan import PlannedMotion
from rig.calibrate.bench import Station, write_picture, write_table
from rig.calibrate.hand_eye import hand_eye_result
from rig.calibrate.result import CalibrationResult
from rig.calibrate.sources import picture_files
from rig.config import BenchConfig

FIRST_POSES = 6
"""Visited as drawn; from then on each next pose is the most informative one."""
_CANDIDATES = 60
_MOUNTED = {
    Setup.EYE_TO_HAND: ("tool", "on the tool, facing the camera"),
    Setup.EYE_IN_HAND: (
        "bench",
        "on the table's mark, face up; the camera is on the tool, looking past the fingers",
    ),
}


def collect_hand_eye(station: Station, target: Target, setup: Setup, count: int) -> CalibrationResult:
    """Visit `count` poses on a bench and solve. Raw pictures and poses.csv stay beside the result.

    The target is firm on the tool (eye-to-hand), or firm on the bench with the camera on the tool
    (eye-in-hand). Raises `OperatorStopError` unless the operator agrees to the motion,
    `DeviceError`, `InputError`.
    """
    config = station.config
    mount, where = _MOUNTED[setup]
    poses = facing_poses(config, station.seed) if mount == "tool" else looking_poses(config, station.seed)
    camera = station.camera()
    session = _Session(target, camera, setup, poses, count, station)
    around = config.camera.look_at_m if mount == "tool" else config.table.position_m
    with station.connected(
        f"The arm will visit {counted(count, 'pose')} around {around} m at up to {SPEED_M_S} m/s, tilted by "
        f"up to 35 degrees, with the target {target.spec} {where}; it chooses from these "
        "places, and leaves out what would be refused.",
        motions=visits([(f"{i:03d}", pose) for i, pose in enumerate(poses, start=1)]),
    ) as (bench, operator):
        agree_to_carry(bench, operator)
        operator.place(f"{target.spec}@{mount}", f"target {target.spec}, firm {where}")
        capture_hand_eye(bench, session.next, session.keep, session.skip)
    write_poses(session.raw, session.rows, "tcp")
    serial = config.camera.serial
    pictures = {path.stem: path for path in picture_files(session.raw)}
    result = hand_eye_result(
        session.samples, camera, serial, setup, str(session.raw), session.rejected, target, pictures
    )
    files = [*pictures.values(), session.raw / "poses.csv"]
    return replace(result, files=files).marked(config.simulated)


def visits(poses: Sequence[tuple[str, Pose]]) -> list[PlannedMotion]:
    return [PlannedMotion(f"{name} visited", pose, (pose,), SPEED_M_S) for name, pose in poses]


def facing_poses(
    config: BenchConfig, seed: int, reach_m: tuple[float, float, float] = (0.08, 0.08, 0.08)
) -> list[Pose]:
    """Return tool poses near the point where the camera is aimed, turned by 10 to 35 degrees, any axis."""
    rng = np.random.default_rng((seed, 30))
    middle = np.add(config.camera.look_at_m, (0.0, 0.0, 0.08))
    poses = []
    for _ in range(_CANDIDATES):
        axis = rng.normal(0, 1, 3)
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.radians(rng.uniform(10, 35)))
        poses.append(Pose.from_rotation(middle + rng.uniform(-1, 1, 3) * reach_m, turn * TOOL_DOWN))
    return poses


def looking_poses(config: BenchConfig, seed: int) -> list[Pose]:
    """Return poses from which a camera that looks along the tool sees the table's mark.

    From 0.26 to 0.36 m, tilted by up to 28 degrees any way, turned by up to 50 about the tool's axis.
    """
    rng = np.random.default_rng((seed, 32))
    poses = []
    for _ in range(_CANDIDATES):
        way = rng.uniform(0.0, 2.0 * np.pi)
        tilt = Rotation.from_rotvec(
            np.radians(rng.uniform(5, 28)) * np.array([np.cos(way), np.sin(way), 0.0])
        )
        turn = tilt * TOOL_DOWN * Rotation.from_euler("z", rng.uniform(-50, 50), degrees=True)
        aim = np.add(config.table.position_m, (*rng.uniform(-0.03, 0.03, 2), 0.0))
        poses.append(Pose.from_rotation(aim - turn.apply([0.0, 0.0, rng.uniform(0.26, 0.36)]), turn))
    return poses


class _Session:
    """Chooses the poses and keeps the samples."""

    def __init__(
        self, target: Target, camera: CameraModel, setup: Setup, candidates: list[Pose], count: int,
        station: Station,
    ) -> None:  # fmt: skip
        self._target, self._camera, self._setup = target, camera, setup
        self._left, self._count, self._station = candidates, count, station
        self.raw: Path = station.raw("hand-eye")
        self.samples: list[HandEyeSample] = []
        self.rejected: list[Rejected] = []
        self.rows: list[str] = []
        self._visited = 0

    def next(self) -> tuple[str, Pose] | None:
        """Return the next pose: first those as drawn, then the one that lowers the predicted sigma most."""
        if len(self.samples) >= self._count or not self._left:
            return None
        self._visited += 1
        return f"{self._visited:03d}", self._left.pop(self._choice())

    def keep(self, capture: HandEyeCapture) -> None:
        """Keep picture and pose, and look for the target in the picture."""
        grey = np.asarray(cv2.cvtColor(capture.frame.image, cv2.COLOR_RGB2GRAY), np.uint8)
        write_picture(self.raw / f"{capture.id}.png", grey)
        if self._station.show is not None:
            self._station.show(capture.frame)
        self.rows.append(pose_row(capture.id, capture.base_T_tcp))
        view = self._target.find(grey, capture.id)
        if isinstance(view, View):
            self.samples.append(HandEyeSample(capture.id, capture.base_T_tcp, view))
            kept = len(self.samples)
            self._station.note(f"{capture.id}: kept, {kept} of {self._count}", kept, self._count)
        else:
            self.skip(capture.id, view)

    def skip(self, name: str, reason: str) -> None:
        """Note why a pose gave no sample."""
        self.rejected.append(Rejected(name, reason))
        self._station.left_out(name, reason)

    def _choice(self) -> int:
        if len(self.samples) < FIRST_POSES:
            return 0
        result = calibrate_hand_eye(self.samples, self._camera, self._setup)
        if result.pose is None:
            return 0
        best = next_pose(result, self._camera, self._left)
        return 0 if best is None else best.index


def pose_row(name: str, pose: Pose) -> str:
    return ",".join([name, *(f"{v:.12g}" for v in (*pose.position_m, *pose.quaternion_xyzw))])


def write_poses(folder: Path, rows: list[str], child_frame: str) -> None:
    """Write poses.csv as `--from` reads it. child_frame: "tcp" for base_T_tcp, "flange" for base_T_flange."""
    header = "id,x_m,y_m,z_m,qx,qy,qz,qw,child_frame"
    write_table(folder / "poses.csv", header, [f"{row},{child_frame}" for row in rows])
