"""The fingertips of a bench at rest: a reference each, and what changed since the one before."""

from pathlib import Path

import cv2
import numpy as np

from calibration.gel.reference import Drift, Reference, compare, judge_reference, make_reference
from drivers.errors import CalibrationError, RecordingError
from protocols.capture_still import capture_still
from rig.assembly import build_bench, build_real_bench
from rig.calibrate import figures
from rig.calibrate.outcome import Outcome, Picture
from rig.config import load_bench

_FRAMES = 30


def collect_references(bench_name: str, seed: int, folder: Path) -> list[Outcome]:
    """Take thirty frames of every fingertip, untouched; nothing moves.

    The mean picture is kept as `tactile-reference-<serial>.png`; one kept earlier is compared with.
    Raises `DeviceError`, `CalibrationError` for a sensor that is touched, dark or frozen.
    """
    config = load_bench(bench_name)
    bench = build_bench(config, seed)[0] if config.simulated else build_real_bench(config)
    outcomes = []
    with bench.connected():
        for tip in bench.fingertips:
            frames = [frame.image for frame in capture_still(bench, tip.sensor, _FRAMES)]
            outcomes.append(_outcome(make_reference(frames), tip.sensor.serial, folder, config.simulated))
    return outcomes


def _outcome(reference: Reference, serial: str, folder: Path, simulated: bool) -> Outcome:
    path = folder / f"tactile-reference-{serial}.png"
    drift = compare(reference, _earlier(path)) if path.exists() else None
    judged = judge_reference(reference, drift)
    if not judged.refusals:
        _keep(reference, path)
    rows, columns = reference.image.shape[:2]
    value = {"image_height": rows, "image_width": columns, "reference_image": path.name}
    return Outcome(
        "tactile", {"tactile": serial}, value, _quality(reference, drift), judged, _numbers(reference, drift),
        f"{_FRAMES} frames at rest", _FRAMES, files=[path] if path.exists() else [],
        pictures=[Picture("Reference", "The mean of the frames.", _png(reference))],
        simulated=simulated, part="reference",
    )  # fmt: skip


def _quality(reference: Reference, drift: Drift | None) -> dict[str, object]:
    quality: dict[str, object] = {
        "noise_grey": reference.noise_grey,
        "saturated": reference.saturated,
        "hot_pixels": reference.hot_pixels,
    }
    if drift is not None and np.isfinite(drift.gain).all():
        quality["drift"] = {"gain": drift.gain, "changed": drift.contact_share, "moved_px": drift.moved_px}
    return quality


def _numbers(reference: Reference, drift: Drift | None) -> dict[str, str]:
    numbers = {"noise": f"{reference.noise_grey:.2f} grey", "saturated": f"{reference.saturated:.2%}"}
    if drift is not None:
        numbers["light since the earlier reference (R, G, B)"] = ", ".join(f"{g:.3f}" for g in drift.gain)
        numbers["picture that changed shape"] = f"{drift.contact_share:.2%}"
    return numbers


def _earlier(path: Path) -> np.ndarray:
    image = cv2.imread(str(path), cv2.IMREAD_COLOR_RGB)
    if image is None:
        raise CalibrationError(f"{path}: the earlier reference cannot be read; remove it to start anew")
    return image.astype(np.float32)


def _keep(reference: Reference, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    picture = np.rint(reference.image).astype(np.uint8)[..., ::-1]
    if not cv2.imwrite(str(path), picture):
        raise RecordingError(f"{path}: cannot be written; choose another --out")


def _png(reference: Reference) -> bytes:
    return figures.thumbnail(np.rint(reference.image).astype(np.uint8))
