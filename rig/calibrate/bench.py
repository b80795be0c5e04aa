"""What calibrations on a bench share: the bench, raw samples, and contact as the fingertips see it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from calibration.camera.files import read_camera, unknown_uncertainty
from calibration.camera.model import CameraModel
from drivers.bench import Bench
from drivers.errors import CalibrationError, RecordingError
from drivers.types import Frame, Image, Pose
from protocols.capture_hand_eye import SPEED_M_S
from protocols.capture_touch import Touch
from protocols.observer import LiftObserver, Phase
from protocols.operator import Operator
from protocols.steps import TRAVEL_SPEED_M_S, home_plan, way_to
from rig.bench.assembly import TABLE_M, TOOL_DOWN, home_pose
from rig.bench.operators import ConsoleOperator
from rig.bench.plan import Plan, PlannedMotion, make_plan
from rig.bench.source import session_bench
from rig.config import BenchConfig
from rig.config.objects import with_objects
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.finder import ContactFinder
from rig.tactile.contact.gate import TouchDebounce
from rig.terminal.onlookers import Event, announce


@dataclass(frozen=True, slots=True)
class Station:
    """The bench, the person and the folder of a calibration.

    config: of the bench. seed: of the simulation. folder: of calibration files; its subfolders hold the raw
    samples. person: answers the questions. say: prints lines of progress. before: called with the plan before
    any device is connected. show: called with each frame, which it must not change; None without a viewer.
    bench: its name, or the path of its file.
    """

    config: BenchConfig
    seed: int
    folder: Path
    person: ConsoleOperator
    say: Callable[[str], None]
    before: Callable[[Plan], None] = lambda plan: None
    show: Callable[[Frame], None] | None = None
    bench: str = "fake"
    _folders: list[Path] = field(default_factory=list)

    def with_objects(self, folder: Path | None) -> "Station":
        """Return a station with a lab's own objects. folder, errors: as in `with_objects`."""
        return replace(self, config=with_objects(self.config, self.bench, folder))

    def note(self, text: str, done: int, total: int) -> None:
        self.say(f"  {text}")
        announce(Event("progress", text, done, total))

    def leave_out(self, name: str, reason: str) -> None:
        self.say(f"  {name}: {reason}")
        announce(Event("fault", f"{name}: {reason}"))

    def camera(self) -> CameraModel:
        """Return the calibrated camera if its file is in the folder, else the bench file's pinhole model.

        Raises `CalibrationError` if the file is damaged, or if its calibration was refused.
        """
        camera = self.config.require("camera")
        known = self.folder / f"camera-{camera.serial}.yaml"
        if known.is_file():
            self.say(f"camera as in {known}")
            return read_camera(known, camera.serial)
        self.say(
            f"camera as the bench file says: f {camera.focal_px:g} px; better: rig calibrate camera first"
        )
        model = CameraModel.pinhole(camera.size_px, camera.focal_px)
        return replace(model, uncertainty=unknown_uncertainty("the bench file"))

    def raw(self, name: str) -> Path:
        """Return the folder for raw samples; it exists and is empty during a `connection`."""
        folder = self.folder / f"{name}-samples"
        self._folders.append(folder)
        return folder

    @contextmanager
    def connection(
        self,
        introduction: str,
        from_home: bool = False,
        motions: Sequence[PlannedMotion] = (),
        asks: bool = True,
    ) -> Iterator[tuple[Bench, Operator]]:
        """Yield the connected bench and its operator.

        introduction: describes the motions; on a real bench the person must agree to it first. from_home:
        whether the arm goes home first. motions: the motions that are known beforehand. asks: False if no
        consent is needed, because nothing moves and no object is placed. Samples of an earlier run are
        removed once the bench is connected. Raises `OperatorStopError` unless the person agrees, and
        `DeviceError`.
        """
        person = self.person if asks else ConsoleOperator(lambda _: False, agreed=True)
        first = [home_plan(home_pose(self.config), "First")] if from_home else []
        plan = make_plan(self.config, [*first, introduction], motions)
        self.before(plan)
        with (
            session_bench(self.config, person, f"{plan.text()}\nAgree?") as benches,
            benches.for_lift(self.seed, "calibration") as (bench, operator),
        ):
            for folder in self._folders:
                try:
                    folder.mkdir(parents=True, exist_ok=True)
                    for old in [*folder.glob("*.png"), *folder.glob("*.csv")]:
                        old.unlink()
                except OSError as error:
                    raise RecordingError(
                        f"{folder}: cannot be written ({error.strerror}); choose another --out"
                    ) from error
            yield bench, operator


def visits(poses: Sequence[tuple[str, Pose]]) -> list[PlannedMotion]:
    return [PlannedMotion(f"{name} visited", pose, (pose,), SPEED_M_S) for name, pose in poses]


def touch_motions(config: BenchConfig, touches: Sequence[Touch]) -> list[PlannedMotion]:
    """Return the motions from home to the poses at which the fingers close."""
    home = home_pose(config)
    return [
        PlannedMotion(
            f"{touch.id} {touch.name}", touch.base_T_grasp, way_to(home, touch.base_T_grasp), TRAVEL_SPEED_M_S
        )
        for touch in touches
    ]


@dataclass(slots=True)
class TouchObserver(LiftObserver):
    """Observes the fingertips while the fingers close. newest: last frame by serial.

    reference: by serial, the mean (H, W, 3) uint8 of the untouched frames of this closing. shown: called with
    each frame after its analysis; it must not change the frame.
    """

    serials: tuple[str, ...]
    newest: dict[str, Frame] = field(default_factory=dict)
    reference: dict[str, Image] = field(default_factory=dict)
    phase_now: Phase | None = None
    shown: Callable[[Frame], None] | None = None
    _still: dict[str, list[Image]] = field(default_factory=dict)
    _finders: dict[str, ContactFinder] = field(default_factory=dict)
    _touches: dict[str, TouchDebounce] = field(default_factory=dict)

    def phase(self, phase: Phase, time_ns: int) -> None:
        """Collect untouched frames during REFERENCE; average them when GRASP begins."""
        self.phase_now = phase
        if phase is Phase.REFERENCE:
            self._still = {serial: [] for serial in self.serials}
            self._finders, self._touches = {}, {}
        elif phase is Phase.GRASP:
            for serial, frames in self._still.items():
                if not frames:
                    raise CalibrationError(f"{serial}: no frame arrived; check that it streams")
                self.reference[serial] = mean_background(frames)
                self._finders[serial] = ContactFinder(self.reference[serial])

    def frame(self, frame: Frame) -> None:
        self.look(frame)
        if self.shown is not None:
            self.shown(frame)

    def look(self, frame: Frame) -> None:
        """Store the newest frame; detect contact if it is of a fingertip."""
        self.newest[frame.serial] = frame
        if frame.serial not in self.serials:
            return
        finder = self._finders.get(frame.serial)
        if finder is None:
            self._still.setdefault(frame.serial, []).append(frame.image)
            return
        seen = finder.find(frame.image).mask is not None
        self._touches.setdefault(frame.serial, TouchDebounce()).update(seen)

    def touching(self, serial: str) -> bool:
        return serial in self._touches and self._touches[serial].sure


def grasp_at(config: BenchConfig, x_m: float = 0.0, z_m: float = 0.0) -> Pose:
    """Return `base_T_tcp` of a hand that closes over the table's mark, moved along the base's x and up.

    Without [table] the mark is that of the bench `fake`: nothing is driven there.
    """
    mark_m = TABLE_M if config.table is None else config.table.position_m
    return Pose.from_rotation(Pose(mark_m).translated(x_m=x_m, z_m=z_m).position_m, TOOL_DOWN)
