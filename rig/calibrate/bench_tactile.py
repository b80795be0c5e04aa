"""The fingertips of a bench: at rest, and with balls of known diameter pressed into them."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from calibration.gel.reference import Reference, assess_reference, drift_since, make_reference
from drivers.errors import CalibrationError, InputError
from drivers.images import load_image
from protocols.capture_hand_eye import capture_still
from protocols.capture_touch import Touch, capture_presses
from rig.calibrate import figures
from rig.calibrate.bench import Station, TouchObserver, grasp_at, touch_motions, write_picture, write_table
from rig.calibrate.result import CalibrationResult, Picture
from rig.calibrate.tactile import tactile_from_folder
from rig.config import BenchConfig

_FRAMES = 30
_REACH_MM = (3.6, 5.6)
"""How far from the gel's middle balls are pressed, across and along it."""
_GRIP_M = (0.0006, 0.0025)
"""Lightest and firmest press past contact, m: one and four steps of a Robotiq 3-Finger."""
_GOLDEN = (5.0**0.5 - 1.0) / 2.0
_CATALOG = "image,diameter(mm),x_mm,y_mm,background"


def collect_references(station: Station) -> list[CalibrationResult]:
    """Take thirty frames of every fingertip, untouched; nothing moves.

    The mean picture is kept as `tactile-reference-<serial>.png`; one kept earlier is compared with.
    Raises `DeviceError`, `CalibrationError` for a sensor that is touched, dark or frozen.
    """
    results = []
    with station.connected("Nothing moves; the fingertips take frames without contact.") as (bench, _):
        for tip in bench.fingertips:
            frames = [frame.image for frame in capture_still(bench, tip.sensor, _FRAMES, station.show)]
            serial = tip.sensor.serial
            simulated = station.config.gives_simulated(serial)
            results.append(_reference_result(make_reference(frames), serial, station.folder, simulated))
            station.note(f"{serial}: frames taken", len(results), len(bench.fingertips))
    return results


def collect_presses(station: Station, balls_mm: Sequence[float], count: int) -> list[CalibrationResult]:
    """Press each ball at `count` places of both gels at once, and solve for scale and colour map.

    The arm moves the contact over the gels by known steps; so the scale along x and y needs no
    ruler. Raises `InputError` for balls the fingers cannot take, `OperatorStopError`, `DeviceError`.
    """
    config = station.config
    if not balls_mm or min(balls_mm) < 2.0 or max(balls_mm) > 30.0:
        raise InputError(
            f"balls of {list(balls_mm)} mm: diameters of 2 to 30 mm make a print of a gel's size"
        )
    folders = {tip.serial: station.raw(f"tactile-{tip.serial}") for tip in config.tactile}
    rows: dict[str, list[str]] = {tip.serial: [] for tip in config.tactile}
    touches = [touch for mm in balls_mm for touch in _places(config, mm, count, station.seed)]
    with station.connected(
        f"The fingers will close gently on a ball on its post, {count} times for each of "
        f"{len(balls_mm)} balls, up to {max(_REACH_MM):.0f} mm from its middle, at most "
        f"{1e3 * _GRIP_M[1]:.1f} mm past contact.",
        from_home=True,
        motions=touch_motions(config, touches),
    ) as (bench, operator):
        watch = TouchObserver(tuple(folders), shown=station.show)

        def keep(touch: Touch) -> None:
            for tip in config.tactile:
                rows[tip.serial].append(
                    _kept(touch, tip.serial, tip.sign, config, watch, folders[tip.serial])
                )
            pressed = len(rows[config.tactile[0].serial])
            station.note(f"{touch.id}: pressed", pressed, len(touches))

        capture_presses(bench, operator, watch, touches, keep)
    for serial, folder in folders.items():
        write_table(folder / "catalog.csv", _CATALOG, rows[serial])
    return [
        tactile_from_folder(folder, serial, None).marked(config.simulated)
        for serial, folder in folders.items()
    ]


def _places(config: BenchConfig, ball_mm: float, count: int, seed: int) -> list[Touch]:
    """Return places spread over the gels, pressed more and less deep."""
    rng = np.random.default_rng((seed, 33, round(100 * ball_mm)))
    first = rng.uniform()
    spec = config.gripper_spec()
    lightest, firmest = map(spec.steps_for, _GRIP_M)
    touches = []
    for i in range(count):
        # a Fibonacci lattice: along the gel step by step, across it by the golden ratio
        x, z = 2.0 * ((first + i * _GOLDEN) % 1.0) - 1.0, 2.0 * (i + 0.5) / count - 1.0
        pose = grasp_at(config, 1e-3 * float(x) * _REACH_MM[0], 1e-3 * float(z) * _REACH_MM[1])
        grip_m = int(rng.integers(lightest, firmest + 1)) * spec.resolution_m
        name = f"ball of {ball_mm:g} mm on its post"
        touches.append(Touch(f"{ball_mm:g}-{i:02d}", f"ball:{ball_mm:g}", name, pose, ball_mm / 1e3, grip_m))
    return touches


def _kept(
    touch: Touch, serial: str, sign: int, config: BenchConfig, watch: TouchObserver, folder: Path
) -> str:
    """Store the frame of a press; return its row with the ball's position in the image."""
    picture, background = f"{touch.id}.png", f"untouched-{touch.id}.png"
    write_picture(folder / picture, watch.newest[serial].image)
    write_picture(folder / background, watch.reference[serial])
    if not (folder / "background.png").exists():
        write_picture(folder / "background.png", watch.reference[serial])
    right, _, up = np.subtract(touch.base_T_grasp.position_m, config.table.position_m) * 1e3
    return f"{picture},{1e3 * touch.width_m:g},{-sign * right:.4f},{up:.4f},{background}"


def _reference_result(reference: Reference, serial: str, folder: Path, simulated: bool) -> CalibrationResult:
    path = folder / f"tactile-reference-{serial}.png"
    drift = drift_since(reference, _earlier(path)) if path.exists() else None
    assessment, mean = assess_reference(reference, drift), np.rint(reference.image).astype(np.uint8)
    if not assessment.refusals:
        write_picture(path, mean)
    rows, columns = mean.shape[:2]
    quality: dict[str, object] = {
        "noise_grey": reference.noise_grey,
        "saturated": reference.saturated,
        "hot_pixels": reference.hot_pixels,
    }
    numbers = {"noise": f"{reference.noise_grey:.2f} grey", "saturated": f"{reference.saturated:.2%}"}
    if drift is not None:
        if np.isfinite(drift.gain).all():
            moved = {"changed": drift.contact_share, "moved_px": drift.moved_px}
            quality["drift"] = {"gain": drift.gain, **moved}
        numbers["light since the earlier reference (R, G, B)"] = ", ".join(f"{g:.3f}" for g in drift.gain)
        numbers["picture that changed shape"] = f"{drift.contact_share:.2%}"
    return CalibrationResult(
        "tactile",
        {"tactile": serial},
        assessment,
        f"{_FRAMES} frames at rest",
        {"image_height": rows, "image_width": columns, "reference_image": path.name},
        quality,
        numbers,
        _FRAMES,
        files=[path] if path.exists() else [],
        pictures=[Picture("Reference", "The mean of the frames.", figures.thumbnail(mean))],
        simulated=simulated,
        part="reference",
    )


def _earlier(path: Path) -> np.ndarray:
    image = load_image(path)
    if image is None:
        raise CalibrationError(f"{path}: the earlier reference cannot be read; remove it to start again")
    return image.astype(np.float32)
