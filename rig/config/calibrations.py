"""The calibrations beside a bench file: find them and check them against its serials."""

from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from calibration.camera.files import calibrated
from calibration.gel.look import load_look
from calibration.store import CalibrationFile, age_days, age_text, check_serials, load, why_damaged
from calibration.verdict import Verdict
from drivers.errors import CalibrationError
from rig.config import BenchConfig, TactileConfig, load_bench
from rig.config.in_use import CalibrationsInUse, CameraInUse, FileInUse, GelInUse, PlaceInUse
from rig.config.messages import faults_of

FOLDER = "calibrations"
LARGEST_TIP_M = 0.05
"""Largest distance of a tip from the bench file's `tcp_m`: a clamped tip stands out of the gels by less."""
SAME_TIP_M = 0.001
"""Distances of a tip from `tcp_m` that differ by less are the same: five sigma of a good calibration."""


def load_calibrated_bench(name_or_path: str, report: Callable[[str], None]) -> BenchConfig:
    """Read a bench with the calibrations in `calibrations/` beside its file.

    For built-in benches that is the current folder. report: prints each file in use with its age and verdict.
    Raises `InputError` for the bench file, `CalibrationError` for a calibration of another device or a
    damaged one.
    """
    config = load_bench(name_or_path)
    found = find_calibrations(config, calibrations_folder(name_or_path), report)
    for key, file in found.files.items():
        of_real = config.mixed and not any(key.endswith(f"-{name}") for name in config.fake_devices)
        mark = "SIMULATED " if config.simulated and not of_real else ""
        age = age_text(age_days(file.created, datetime.now(UTC)))
        report(f"{mark}calibration in use: {file.file}, {age} old, {file.verdict}")
    return config.model_copy(update={"calibrations": found}) if found.files else config


def calibrations_folder(name_or_path: str) -> Path:
    """Return the folder of a bench's calibrations: beside its file; else the current folder."""
    path = Path(name_or_path)
    return (path.parent if path.is_file() else Path()) / FOLDER


def find_calibrations(
    config: BenchConfig, folder: Path, report: Callable[[str], None] = lambda _: None
) -> CalibrationsInUse:
    """Read a folder's calibrations for the devices of a bench; none without such a folder.

    If all files of a kind belong to other devices, that is an error: a swapped device would otherwise go
    unnoticed. Calibrations with verdict "refused" are not used. report: called with each remark on a
    file, except on its age and verdict. Raises `CalibrationError`.
    """
    wanted: list[tuple[str, dict[str, str]]] = []
    if config.has("camera"):
        camera = {"camera": config.require("camera").serial}
        wanted += [("camera", camera), ("hand-eye", camera)]
    if config.has("gripper"):
        wanted.append(("gripper", {"gripper": config.name}))
    wanted += [("tactile", {"tactile": tactile.serial}) for tactile in config.tactile]
    if config.has("arm"):
        wanted.append(("tcp", {"tool": config.name}))
        wanted += [("sync", {"reference": "arm", "stream": each.serial}) for each in config.sensors]
    elif config.has("camera"):
        reference = config.require("camera").serial
        wanted += [("sync", {"reference": reference, "stream": t.serial}) for t in config.tactile]
    found = CalibrationsInUse()
    for kind, serials in wanted:
        found = found.joined(_used(config, folder, kind, serials, report))
    for tactile in config.tactile:
        found = found.joined(_gel(config, tactile))
    return found


def _gel(config: BenchConfig, tactile: TactileConfig) -> CalibrationsInUse:
    """Return the calibrated colours that the bench file names for a fingertip.

    A simulated gel may use the calibration of any unit, a real one only its own, made on itself.
    """
    if tactile.gel is None:
        return CalibrationsInUse()
    real, path = tactile.serial in config.real_devices, Path(tactile.gel)
    file = load(path, "tactile", {"tactile": tactile.serial} if real else None)
    _refuse_simulated(config, file, path, real)
    look = load_look(path)
    if look.shape[::-1] != tactile.size_px:
        raise CalibrationError(
            f"{path}: was made of pictures of {look.shape[::-1]} px, and {tactile.serial} has size_px = "
            f"{list(tactile.size_px)}; calibrate it at that size"
        )
    facts = _facts(path, file)
    return CalibrationsInUse(gel={tactile.serial: GelInUse.of(look)}, files={f"gel-{tactile.serial}": facts})


def _used(
    config: BenchConfig, folder: Path, kind: str, serials: Mapping[str, str], report: Callable[[str], None]
) -> CalibrationsInUse:
    """Find a kind's file for these serials and return the values in use; none without a file."""
    path = _find(folder, kind, serials)
    if path is None:
        return CalibrationsInUse()
    file = load(path, kind, serials, allow_refused=True)
    if file.assessment.verdict is Verdict.REFUSED:
        report(f"calibration not used: {path}: was refused when it was made ({file.assessment.reasons[0]})")
        return CalibrationsInUse()
    devices = {*serials.values(), {"gripper": "gripper", "tcp": "arm"}.get(kind, "")}
    _refuse_simulated(config, file, path, not devices.isdisjoint(config.real_devices))
    try:
        taken = _taken(config, report, file, str(path))
    except ValidationError as error:
        found = "; ".join(
            f"{'.'.join(map(str, key))}: {why}" for key, why in faults_of(error, CalibrationsInUse)
        )
        raise CalibrationError(
            f"{path}: has invalid values ({found}); make it again with rig calibrate"
        ) from error
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise CalibrationError(
            f"{path}: damaged ({why_damaged(path, error)}); make it again with rig calibrate"
        ) from error
    if taken is None:
        return CalibrationsInUse()
    facts = _facts(path, file)
    return taken.joined(CalibrationsInUse(files={"-".join([kind, *serials.values()]): facts}))


def _refuse_simulated(config: BenchConfig, file: CalibrationFile, path: Path, real: bool) -> None:
    """Raise `CalibrationError` if a calibration of simulated devices would be used on a real one."""
    if real and file.inputs.get("simulated"):
        raise CalibrationError(
            f"{path}: was made on simulated devices, but bench '{config.name}' is real; calibrate it, "
            "or move the file away"
        )


def _facts(path: Path, file: CalibrationFile) -> FileInUse:
    return FileInUse(
        file=str(path),
        sha256=sha256(path.read_bytes()).hexdigest(),
        created=file.created,
        verdict=str(file.assessment.verdict),
    )


def _find(folder: Path, kind: str, serials: Mapping[str, str]) -> Path | None:
    """Return the kind's file for these serials; None without a file of that kind.

    Raises `CalibrationError` if all files of the kind belong to other devices, except for streams and
    fingertips, of which a bench has several, and for clamped tips, of which nothing is replaced.
    """
    wanted = folder / f"{'-'.join([kind, *serials.values()])}.yaml"
    if wanted.is_file():
        return wanted
    others = [] if kind in ("sync", "tactile", "tcp") else sorted(folder.glob(f"{kind}-*.yaml"))
    if others:
        check_serials(others[0], load(others[0], kind, allow_refused=True).serials, serials)
    return None


def _taken(
    config: BenchConfig, report: Callable[[str], None], file: CalibrationFile, where: str
) -> CalibrationsInUse | None:
    """Return the values to use from a calibration file; None if there are none. where: its path."""
    value = file.value
    match file.kind:
        case "camera":
            camera = calibrated(file, where)
            size_px = config.require("camera").size_px
            if camera.size != size_px:
                raise CalibrationError(
                    f"{where}: was made from pictures of {camera.size} px, but the bench file has size_px = "
                    f"{list(size_px)}; calibrate at that size, or correct it"
                )
            return CalibrationsInUse(camera=CameraInUse.of(camera))
        case "hand-eye" if value.get("setup") == "eye-to-hand":
            x, y, z = (float(v) for v in _numbers(file, where, "translation_m", 3))
            a, b, c, d = (float(v) for v in _numbers(file, where, "quaternion_xyzw", 4))
            sigma_rad = 0.0  # of the camera's orientation about its least certain axis
            if "covariance" in file.quality:
                turns = np.reshape(np.asarray(file.quality["covariance"], np.float64), (6, 6))[:3, :3]
                sigma_rad = float(np.sqrt(np.linalg.eigvalsh(turns)[-1]))
            place = PlaceInUse(position_m=(x, y, z), quaternion_xyzw=(a, b, c, d), turn_sigma_rad=sigma_rad)
            return CalibrationsInUse(base_T_camera=place)
        case "hand-eye":
            why = "the camera is on the tool, and lifts are watched by a fixed one"
            report(f"calibration not used: {where}: {why}")
        case "tactile" if "pixel_aspect" in value:
            return CalibrationsInUse(pixel_aspect={file.serials["tactile"]: float(value["pixel_aspect"])})
        case "gripper" if isinstance(table := value.get("closing"), Mapping):
            pairs = zip(table["counts"], table["opening_m"], strict=True)
            return CalibrationsInUse(
                opening=tuple((float(counts), float(opening)) for counts, opening in pairs)
            )
        case "sync":
            return CalibrationsInUse(time_shift_s={file.serials["stream"]: float(value["add_to_stream_s"])})
        case "tcp":
            return _tip(config, report, file, where)
    return None


def _tip(
    config: BenchConfig, report: Callable[[str], None], file: CalibrationFile, where: str
) -> CalibrationsInUse | None:
    """Compare the bench file's TCP with the clamped tip; nothing is replaced.

    A tip that was not compared with a bench file when it was calibrated is not used. Raises
    `CalibrationError` if TCP and tip are further apart than a clamped tip can be, unless they were so when
    the tip was calibrated and that was accepted.
    """
    if "tip_from_tcp_m" not in file.value:
        report(f"calibration not used: {where}: its tip was not compared with the tcp_m of a bench file")
        return None
    tip_m = np.asarray(_numbers(file, where, "translation_m", 3), np.float64)
    tcp = config.require("arm").flange_T_tcp()
    out_m = tcp.rotation.inv().apply(tip_m - tcp.position_m)
    before_m = np.asarray(_numbers(file, where, "tip_from_tcp_m", 3), np.float64)
    text = f"the clamped tip of {where} is {1e3 * np.linalg.norm(out_m):.1f} mm from tcp_m"
    if not np.linalg.norm(out_m) <= max(LARGEST_TIP_M, float(np.linalg.norm(before_m)) + SAME_TIP_M):
        raise CalibrationError(
            f"{text}, and a clamped tip is within {1e3 * LARGEST_TIP_M:.0f} mm of it: correct tcp_m, or move "
            "the file away and run rig calibrate tcp again"
        )
    way = ", ".join(f"{1e3 * v:.1f}" for v in out_m)
    report(f"{text}: {way} mm along the tool's axes")
    return CalibrationsInUse()


def _numbers(file: CalibrationFile, where: str, key: str, count: int) -> list[Any]:
    values = file.value.get(key)
    if not isinstance(values, list) or len(values) != count:
        raise CalibrationError(f"{where}: has no {key} of {count} numbers; make it again with rig calibrate")
    return values
