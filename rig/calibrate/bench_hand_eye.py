"""Hand-eye on a bench: poses chosen, visited, kept as files, and solved like any other folder."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from calibration.boards import Target
from calibration.camera_model import CameraModel
from calibration.hand_eye.guidance import next_pose
from calibration.hand_eye.samples import Sample, Setup
from calibration.hand_eye.solve import HandEyeResult, calibrate_hand_eye
from calibration.store import write_text
from calibration.verdict import Rejected
from calibration.views import View
from drivers.bench import Bench
from drivers.errors import InputError, OperatorStopError
from drivers.types import Pose
from protocols.capture_hand_eye import SPEED_M_S, HandEyeCapture, capture_hand_eye
from rig.assembly import TOOL_DOWN, build_bench, build_real_bench
from rig.calibrate.hand_eye import hand_eye_outcome
from rig.calibrate.outcome import Outcome
from rig.config import BenchConfig, load_bench

FIRST_POSES = 6
"""Visited before there is an answer to improve; then each next pose is the one that tells most."""
_CANDIDATES = 60


def collect_hand_eye(
    bench_name: str,
    seed: int,
    target: Target,
    setup: Setup,
    count: int,
    folder: Path,
    agree: Callable[[str], bool],
    say: Callable[[str], None],
) -> Outcome:
    """Visit `count` poses on a bench and solve. Raw pictures and poses.csv stay in `folder`.

    The target is firm on the tool (eye-to-hand), or firm on the bench (eye-in-hand). Raises
    `OperatorStopError` unless the operator agrees to the motion, `DeviceError`, `InputError`.
    """
    if setup is not Setup.EYE_TO_HAND:
        raise InputError(
            "on a bench the camera stands: eye-to-hand only; solve eye-in-hand with --from FOLDER"
        )
    config = load_bench(bench_name)
    with connected(config, seed, target) as bench:
        if not bench.simulated and not agree(
            f"The arm will visit {count} poses around {config.camera.look_at_m} m at up to {SPEED_M_S} m/s, "
            f"tilted by up to 35 degrees, with the target {target.spec} on the tool. Agree?"
        ):
            raise OperatorStopError("stopped: the operator did not agree; nothing was moved")
        session = _Session(bench, target, _camera(config), candidate_poses(config, seed), count, folder, say)
        capture_hand_eye(bench, session.next, session.keep, session.skip)
    session.write()
    return hand_eye_outcome(
        session.samples,
        _camera(config),
        config.camera.serial,
        setup,
        str(session.raw),
        session.rejected,
        target,
        config.simulated,
    )


def candidate_poses(
    config: BenchConfig, seed: int, reach_m: tuple[float, float, float] = (0.08, 0.08, 0.08)
) -> list[Pose]:
    """Poses of the tool around the place the camera looks at, turned by 10 to 35 degrees about any axis."""
    rng = np.random.default_rng((seed, 30))
    middle = np.add(config.camera.look_at_m, (0.0, 0.0, 0.08))
    poses = []
    for _ in range(_CANDIDATES):
        axis = rng.normal(0, 1, 3)
        turn = Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.radians(rng.uniform(10, 35)))
        poses.append(Pose.from_rotation(middle + rng.uniform(-1, 1, 3) * reach_m, turn * TOOL_DOWN))
    return poses


class _Session:
    """Chooses poses, keeps what comes back, and writes it down."""

    def __init__(
        self,
        bench: Bench,
        target: Target,
        camera: CameraModel,
        candidates: list[Pose],
        count: int,
        folder: Path,
        say: Callable[[str], None],
    ) -> None:
        self._bench, self._target, self._camera = bench, target, camera
        self._left, self._count, self._say = candidates, count, say
        self.raw = folder / "hand-eye-samples"
        self.samples: list[Sample] = []
        self.rejected: list[Rejected] = []
        self._rows: list[str] = []
        self._visited = 0

    def next(self) -> tuple[str, Pose] | None:
        """The next pose: the first ones as drawn, then the one that lowers the predicted sigma most."""
        if len(self.samples) >= self._count or not self._left:
            return None
        self._visited += 1
        return f"{self._visited:03d}", self._left.pop(self._choice())

    def keep(self, capture: HandEyeCapture) -> None:
        """Keep picture and pose, and see whether the target is in it."""
        self.raw.mkdir(parents=True, exist_ok=True)
        grey = cv2.cvtColor(capture.frame.image, cv2.COLOR_RGB2GRAY)
        cv2.imwrite(str(self.raw / f"{capture.id}.png"), grey)
        numbers = (*capture.base_T_tcp.position_m, *capture.base_T_tcp.quaternion_xyzw)
        self._rows.append(",".join([capture.id, *(f"{v:.12g}" for v in numbers)]))
        view = self._target.find(np.asarray(grey, np.uint8), capture.id)
        if isinstance(view, View):
            self.samples.append(Sample(capture.id, capture.base_T_tcp, view))
            self._say(f"  {capture.id}: kept, {len(self.samples)} of {self._count}")
        else:
            self.skip(capture.id, view)

    def skip(self, name: str, reason: str) -> None:
        """Note why a pose gave no sample."""
        self.rejected.append(Rejected(name, reason))
        self._say(f"  {name}: {reason}")

    def write(self) -> None:
        """Write the poses beside the pictures, as `--from` reads them."""
        header = "id,x_m,y_m,z_m,qx,qy,qz,qw"
        write_text(self.raw / "poses.csv", "\n".join([header, *self._rows]) + "\n")

    def _choice(self) -> int:
        if len(self.samples) < FIRST_POSES:
            return 0
        result: HandEyeResult = calibrate_hand_eye(self.samples, self._camera, Setup.EYE_TO_HAND)
        if result.pose is None:
            return 0
        best = next_pose(result, self._camera, self._left)
        return 0 if best is None else best.index


def _camera(config: BenchConfig) -> CameraModel:
    """The bench file's camera; distortion is taken as none there."""
    intrinsics = config.camera.intrinsics()
    width, height = config.camera.size_px
    return CameraModel(
        (width, height), np.asarray(intrinsics.camera_matrix), np.asarray(intrinsics.distortion)
    )


@contextmanager
def connected(config: BenchConfig, seed: int, target: Target) -> Iterator[Bench]:
    """The bench, connected; a simulated one gets a camera that sees the target on its tool."""
    if config.simulated:
        from rig.calibrate.simulated import TargetCamera

        made, _ = build_bench(config, seed)
        bench = replace(made, camera=TargetCamera(made, config.camera, target, seed))
    else:
        bench = build_real_bench(config)
    with bench.connected():
        yield bench
