"""The calibrations beside a bench file: find them and check them against its serials."""

from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from calibration.gel.look import look_file
from calibration.store import CalibrationFile, age_days, age_text, check_serials, load
from calibration.verdict import Verdict
from drivers.errors import CalibrationError
from rig.config import BenchConfig, TactileConfig, load_bench
from rig.config.measured_values import GEL, Calibrations, FileInUse, file_in_use, numbers

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
) -> Calibrations:
    """Read a folder's calibrations for the devices of a bench; none without such a folder.

    If all files of a kind belong to other devices, that is an error: a swapped device would otherwise go
    unnoticed. Calibrations with verdict "refused" are not used. report: called with each remark on a
    file, except on its age and verdict. Raises `CalibrationError`.
    """
    wanted: list[tuple[str, dict[str, str]]] = []
    if config.camera is not None:
        camera = {"camera": config.camera.serial}
        wanted += [("camera", camera), ("hand-eye", camera)]
    if config.gripper is not None:
        wanted.append(("gripper", {"gripper": config.name}))
    wanted += [("tactile", {"tactile": tactile.serial}) for tactile in config.tactile]
    if config.arm is not None:
        wanted.append(("tcp", {"tool": config.name}))
        wanted += [("sync", {"reference": "arm", "stream": each.serial}) for each in config.sensors]
    elif config.camera is not None:
        reference = config.camera.serial
        wanted += [("sync", {"reference": reference, "stream": t.serial}) for t in config.tactile]
    files: dict[str, FileInUse] = {}
    for kind, serials in wanted:
        path = _find(folder, kind, serials)
        if path is not None and (file := _usable(config, path, kind, serials, report)):
            files["-".join([kind, *serials.values()])] = file_in_use(path, file)
    for tactile in config.tactile:
        if tactile.gel is not None:
            files[f"{GEL}-{tactile.serial}"] = _gel(config, tactile, Path(tactile.gel))
    found = Calibrations(files).check()
    _check_sizes(config, found)
    return found


def _check_sizes(config: BenchConfig, found: Calibrations) -> None:
    """Raise `CalibrationError` if a camera or a gel was calibrated with pictures of another size."""
    sizes = {} if found.camera is None else {"camera": (found.camera.size, config.require("camera"))}
    tips = {tactile.serial: tactile for tactile in config.tactile}
    sizes |= {f"{GEL}-{serial}": (look.shape[::-1], tips[serial]) for serial, look in found.gel.items()}
    for kind, (size, device) in sizes.items():
        if size != device.size_px:
            path = next(each.file for name, each in found.files.items() if name.startswith(kind))
            raise CalibrationError(
                f"{path}: was made from pictures of {size} px, but the bench file has size_px = "
                f"{list(device.size_px)} for {device.serial}; calibrate at that size, or correct it"
            )


def _gel(config: BenchConfig, tactile: TactileConfig, path: Path) -> FileInUse:
    """Return the calibrated colours that the bench file names for a fingertip.

    A simulated gel may use the calibration of any unit, a real one only its own, made on itself.
    """
    real = tactile.serial in config.real_devices
    file = load(path, "tactile", {"tactile": tactile.serial} if real else None)
    _refuse_simulated(config, file, path, real)
    return file_in_use(path, file, look_file(path))


def _usable(
    config: BenchConfig, path: Path, kind: str, serials: Mapping[str, str], report: Callable[[str], None]
) -> CalibrationFile | None:
    """Return a kind's file for these serials; None if it has no value that is used."""
    file = load(path, kind, serials, allow_refused=True)
    if file.assessment.verdict is Verdict.REFUSED:
        report(f"calibration not used: {path}: was refused when it was made ({file.assessment.reasons[0]})")
        return None
    devices = {*serials.values(), {"gripper": "gripper", "tcp": "arm"}.get(kind, "")}
    _refuse_simulated(config, file, path, not devices.isdisjoint(config.real_devices))
    value = file.value
    if kind == "hand-eye" and value.get("setup") != "eye-to-hand":
        why = "the camera is on the tool, and lifts are watched by a fixed one"
    elif kind == "tcp" and "tip_from_tcp_m" not in value:
        why = "its tip was not compared with the tcp_m of a bench file"
    else:
        if kind == "tcp":
            _check_tip(config, report, file, path)
        # a gripper that was only opened, and a gel of which only a reference was taken
        lacks = {"gripper": "closing", "tactile": "pixel_aspect"}.get(kind)
        return None if lacks is not None and lacks not in value else file
    report(f"calibration not used: {path}: {why}")
    return None


def _refuse_simulated(config: BenchConfig, file: CalibrationFile, path: Path, real: bool) -> None:
    """Raise `CalibrationError` if a calibration of simulated devices would be used on a real one."""
    if real and file.inputs.get("simulated"):
        raise CalibrationError(
            f"{path}: was made on simulated devices, but bench '{config.name}' is real; calibrate it, "
            "or move the file away"
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


def _check_tip(config: BenchConfig, report: Callable[[str], None], file: CalibrationFile, path: Path) -> None:
    """Compare the bench file's TCP with the clamped tip, of which nothing is replaced.

    Raises `CalibrationError` if TCP and tip are further apart than a clamped tip can be, unless they were so
    when the tip was calibrated and that was accepted.
    """
    tip_m = np.asarray(numbers(path, file, "translation_m", 3), np.float64)
    tcp = config.require("arm").flange_T_tcp()
    out_m = tcp.rotation.inv().apply(tip_m - tcp.position_m)
    before_m = np.asarray(numbers(path, file, "tip_from_tcp_m", 3), np.float64)
    text = f"the clamped tip of {path} is {1e3 * np.linalg.norm(out_m):.1f} mm from tcp_m"
    if not np.linalg.norm(out_m) <= max(LARGEST_TIP_M, float(np.linalg.norm(before_m)) + SAME_TIP_M):
        raise CalibrationError(
            f"{text}, and a clamped tip is within {1e3 * LARGEST_TIP_M:.0f} mm of it: correct tcp_m, or move "
            "the file away and run rig calibrate tcp again"
        )
    way = ", ".join(f"{1e3 * v:.1f}" for v in out_m)
    report(f"{text}: {way} mm along the tool's axes")
