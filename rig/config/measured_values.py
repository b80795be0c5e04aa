"""The calibrations of a bench: the files in use, and the values in them that replace nominal ones."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import Any, Self, TypeVar

import numpy as np

from calibration.camera.files import camera_of
from calibration.camera.model import CameraModel, CameraUncertainty
from calibration.gel.look import GelLook, load_look, look_file
from calibration.gel.noise import CameraNoise
from calibration.store import CalibrationFile, load, why_damaged
from drivers.errors import CalibrationError
from drivers.types import Pose
from rig.config.fields import Strict

Value = TypeVar("Value")
GEL = "gel"
"""Beginning of the names of files with the calibrated colours of a fingertip's gel."""
ASPECTS = (0.5, 2.0)
SHIFTS_S = (-1.0, 1.0)
"""Range of clock offsets: with a larger one a sensor is not usable for a lift."""
COUNTS = (0.0, 255.0)
OPENINGS_M = (-0.2, 0.2)
"""Range of openings; negative if the fingers would close beyond each other."""
TURN_SIGMAS_RAD = (0.0, 0.2)


class FileInUse(Strict):
    """A calibration file: path, hash (for a gel also of its look), creation date and verdict."""

    file: str
    sha256: str
    created: str
    verdict: str


@dataclass(frozen=True, eq=False)
class Calibrations:
    """Calibration files by kind and serials, as "camera-SIM-C0001", and the values that replace nominal ones.

    The files are read when a value is needed first. folder: of the copies in a session; None if each file is
    at the path `FileInUse.file`. Reading a value raises `CalibrationError` for a damaged file, an impossible
    value, and a copy that is not the file of the session.
    """

    files: Mapping[str, FileInUse] = field(default_factory=dict)
    folder: Path | None = None

    def __eq__(self, other: object) -> bool:
        """Whether the files have the same names and contents."""
        return isinstance(other, Calibrations) and self._hashes() == other._hashes()

    @cached_property
    def camera(self) -> CameraModel | None:
        """The camera, with its covariance if the file states one."""
        camera = next(iter(self._values("camera", _camera).values()), None)
        known = camera and camera.uncertainty
        if camera is None or known is None:
            return camera
        stated = CameraUncertainty(known.terms, known.covariance) if known.terms else None
        return replace(camera, uncertainty=stated)

    @cached_property
    def base_T_camera(self) -> Pose | None:  # noqa: N802 - frame names keep their case
        """The pose of a fixed camera."""
        return next(iter(self._values("hand-eye", _pose).values()), None)

    @cached_property
    def camera_turn_sigma_rad(self) -> float:
        """One sigma of the orientation of `base_T_camera` about its least certain axis; 0 if unknown."""
        return next(iter(self._values("hand-eye", _turn_sigma_rad).values()), 0.0)

    @cached_property
    def pixel_aspect(self) -> dict[str, float]:
        """Width over height of a pixel by the serial of the fingertip."""
        return self._values("tactile", _aspect)

    @cached_property
    def time_shift_s(self) -> dict[str, float]:
        """The offset to add to the times of a sensor, s, by its serial."""
        return dict(self._values("sync", _shift).values())

    @cached_property
    def opening(self) -> tuple[tuple[float, float], ...]:
        """Pairs of counts and opening in m while the fingers close, counts rising."""
        return next(iter(self._values("gripper", _openings).values()), ())

    @cached_property
    def gel(self) -> dict[str, GelLook]:
        """The calibrated colours by the serial of the fingertip, on a black background.

        Each lift has its own background.
        """
        return {
            name.removeprefix(f"{GEL}-"): _on_black(load_look(look)) for name, look in self._looks().items()
        }

    def check(self) -> Self:
        """Read all values, and return these calibrations."""
        values = [name for name, each in vars(type(self)).items() if isinstance(each, cached_property)]
        for name in values:
            getattr(self, name)
        return self

    def of_fingertips(self) -> "Calibrations":
        own = {name: each for name, each in self.files.items() if name.startswith(("tactile-", f"{GEL}-"))}
        return Calibrations(own, self.folder)

    def contents(self) -> Iterator[tuple[str, bytes]]:
        """Yield name and content of each file, as a session stores them."""
        for name in self.files:
            yield f"{name}.yaml", self._path(name).read_bytes()
        for name, look in self._looks().items():
            yield f"{name}.npz", look.read_bytes()

    @cached_property
    def _loaded(self) -> dict[str, CalibrationFile]:
        loaded, looks = {}, self._looks()
        for name, about in self.files.items():
            path, kind = self._path(name), kind_of(name)
            loaded[name] = load(path, "tactile" if kind == GEL else kind)
            if self.folder is not None and hash_of(path, looks.get(name)) != about.sha256:
                raise CalibrationError(f"{path}: is not the file that session.json names: it was changed")
        return loaded

    def _values(self, kind: str, read: Callable[[Path, CalibrationFile], Value]) -> dict[str, Value]:
        """Return a value of each file of a kind, by the serials in the file's name."""
        found = {}
        for name, file in self._loaded.items():
            if kind_of(name) != kind:
                continue
            path = self._path(name)
            try:
                found[name.removeprefix(f"{kind}-")] = read(path, file)
            except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
                raise CalibrationError(
                    f"{path}: damaged ({why_damaged(path, error)}); make it again with rig calibrate"
                ) from error
        return found

    def _path(self, name: str) -> Path:
        return Path(self.files[name].file) if self.folder is None else self.folder / f"{name}.yaml"

    def _looks(self) -> dict[str, Path]:
        """Return the look of each gel. In a session it has the name of the gel's file."""
        paths = {name: self._path(name) for name in self.files if kind_of(name) == GEL}
        if self.folder is None:
            return {name: look_file(path) for name, path in paths.items()}
        return {name: path.with_suffix(".npz") for name, path in paths.items()}

    def _hashes(self) -> dict[str, str]:
        return {name: each.sha256 for name, each in self.files.items()}


def kind_of(name: str) -> str:
    """Return the kind in the name of a file: "gel", or a kind of `rig calibrate`."""
    return "hand-eye" if name.startswith("hand-eye-") else name.partition("-")[0]


def file_in_use(path: Path, file: CalibrationFile, look: Path | None = None) -> FileInUse:
    """Describe a calibration file. look: of a gel."""
    return FileInUse(
        file=str(path),
        sha256=hash_of(path, look),
        created=file.created,
        verdict=str(file.assessment.verdict),
    )


def hash_of(path: Path, look: Path | None) -> str:
    """Return the SHA-256 of a file, together with its look. Raises `CalibrationError`."""
    try:
        return sha256(b"".join(each.read_bytes() for each in (path, look) if each is not None)).hexdigest()
    except OSError as error:
        raise CalibrationError(f"{error.filename}: cannot be read ({error.strerror})") from error


def _camera(path: Path, file: CalibrationFile) -> CameraModel:
    return camera_of(file, str(path))


def _pose(path: Path, file: CalibrationFile) -> Pose:
    # imported here: it loads scipy's rotations, which delay the start of most commands
    from calibration.poses import pose_fault

    x, y, z = (float(v) for v in numbers(path, file, "translation_m", 3))
    a, b, c, d = (float(v) for v in numbers(path, file, "quaternion_xyzw", 4))
    pose = Pose((x, y, z), (a, b, c, d))
    if fault := pose_fault(pose, "base_T_camera"):
        raise _invalid(path, fault)
    return pose


def _turn_sigma_rad(path: Path, file: CalibrationFile) -> float:
    if "covariance" not in file.quality:
        return 0.0
    turns = np.reshape(np.asarray(file.quality["covariance"], np.float64), (6, 6))[:3, :3]
    sigma_rad = float(np.sqrt(np.linalg.eigvalsh(turns)[-1]))
    return _within(path, "sigma of the orientation", sigma_rad, TURN_SIGMAS_RAD)


def _aspect(path: Path, file: CalibrationFile) -> float:
    return _within(path, "pixel_aspect", file.value["pixel_aspect"], ASPECTS)


def _shift(path: Path, file: CalibrationFile) -> tuple[str, float]:
    """Return the serial of the stream, and the offset to add to its times, s."""
    return file.serials["stream"], _within(path, "add_to_stream_s", file.value["add_to_stream_s"], SHIFTS_S)


def _openings(path: Path, file: CalibrationFile) -> tuple[tuple[float, float], ...]:
    table = file.value["closing"]
    pairs = tuple(
        (_within(path, "counts", counts, COUNTS), _within(path, "opening_m", opening_m, OPENINGS_M))
        for counts, opening_m in zip(table["counts"], table["opening_m"], strict=True)
    )
    for (counts, opening_m), (more, next_m) in pairwise(pairs):
        if not (counts < more and opening_m >= next_m):
            way = f"from {counts:g} to {more:g} counts"
            raise _invalid(path, f"the opening does not decrease {way}: {opening_m:.4g} to {next_m:.4g} m")
    return pairs


def _on_black(look: GelLook) -> GelLook:
    """Return the colours of a look, with noise that is independent between pixels, on a black background."""
    return GelLook(
        np.zeros((*look.shape, 3), np.float32),
        look.weights,
        look.place_degree,
        look.by_background,
        look.shadows,
        look.mm_per_px,
        CameraNoise.independent(look.noise.colours),
        None,
    )


def numbers(path: Path, file: CalibrationFile, key: str, count: int) -> list[Any]:
    """Return a list of numbers in a file. Raises `CalibrationError` if it has another length."""
    values = file.value.get(key)
    if not isinstance(values, list) or len(values) != count:
        raise CalibrationError(f"{path}: has no {key} of {count} numbers; make it again with rig calibrate")
    return values


def _within(path: Path, name: str, value: Any, limits: tuple[float, float]) -> float:
    """Return a number. Raises `CalibrationError` unless it is within limits."""
    low, high = limits
    if not low <= float(value) <= high:
        raise _invalid(path, f"{name} must be from {low:g} to {high:g}, found {float(value):g}")
    return float(value)


def _invalid(path: Path, why: str) -> CalibrationError:
    return CalibrationError(f"{path}: has invalid values ({why}); make it again with rig calibrate")
