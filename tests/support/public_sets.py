"""Small synthetic copies of a public set's layout: drawn here, none of its data."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from rig.contract_checks import gel, pressed_bar

RATE_HZ = 25.0
START_DEG = 20.0


def turns_deg(frames: int = 40) -> NDArray[np.float64]:
    """At rest, then turning by 1 degree a frame."""
    return np.maximum(0.0, np.arange(frames) - 14.0)


def about_z(angle_deg: float) -> NDArray[np.float64]:
    """A rigid motion that turns about z, tilts a little and moves."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler(
        "zx", (angle_deg, 1.0 if angle_deg else 0.0), degrees=True
    ).as_matrix()
    matrix[:3, 3] = 1e-4 * angle_deg
    return matrix


def write_trial(folder: Path, frames: int = 40) -> Path:
    """A trial in the layout of TactileTracking."""
    folder.mkdir(parents=True)
    writer = cv2.VideoWriter(
        str(folder / "gelsight.avi"), cv2.VideoWriter.fourcc(*"FFV1"), RATE_HZ, (240, 320)
    )
    empty, masks = gel(320, 240), []
    for number, turn in enumerate(turns_deg(frames)):
        image = pressed_bar(START_DEG + turn, number + 1)
        masks.append(cv2.absdiff(image, empty).max(axis=2) > 12)
        writer.write(np.ascontiguousarray(image[..., ::-1]))
    writer.release()
    np.save(folder / "contact_masks.npy", np.array(masks))
    np.save(folder / "true_start_T_currs.npy", np.array([about_z(turn) for turn in turns_deg(frames)]))
    return folder
