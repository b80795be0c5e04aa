"""Run the angle networks that the paper compares with, in ONNX files: from one image, or from wrenches."""

from importlib.resources import as_file
from pathlib import Path

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from drivers.errors import InputError
from drivers.types import Image
from rig.tactile.contact.model_files import MODELS, open_model, run_model
from rig.tactile.contact.network_input import frame_planes
from rig.tactile.peers.wrench_steps import Wrench

Memory = NDArray[np.float32]

_HOW = "rig train-angle"
_LARGEST = 4096
"""Largest side of the memory."""


class ImageAngleNetwork:
    """A network that estimates an angle from one tactile frame. size: (width, height) of its input in px."""

    def __init__(self, session: onnxruntime.InferenceSession, name: str) -> None:
        entries, answers = session.get_inputs(), session.get_outputs()
        if not entries or not answers:
            raise InputError(f"{name}: has no input or no output: make it with {_HOW} anglenet")
        shape = list(entries[0].shape)
        fits = len(shape) == 4 and shape[:2] == [1, 3] and all(isinstance(side, int) for side in shape[2:])
        if len(entries) != 1 or not fits or list(answers[0].shape) != [1]:
            raise InputError(
                f"{name}: maps {[list(e.shape) for e in entries]} to {list(answers[0].shape)}, but a network "
                f"for an angle from a frame maps (1, 3, h, w) to (1): make one with {_HOW} anglenet"
            )
        self._session, self._name, self._key = session, name, entries[0].name
        self.size = (int(shape[3]), int(shape[2]))

    def angle_deg(self, image: Image) -> float:
        """Return the image angle, deg, of the object in an (H, W, 3) uint8 RGB frame."""
        planes = frame_planes(image, self.size)[None]
        return float(run_model(self._session, self._name, {self._key: planes})[0].reshape(-1)[0])


class WrenchAngleNetwork:
    """A recurrent network that estimates an angle from wrenches; the caller keeps its memory."""

    def __init__(self, session: onnxruntime.InferenceSession, name: str) -> None:
        shapes = {entry.name: list(entry.shape) for entry in session.get_inputs()}
        sized = all(isinstance(side, int) and 0 < side <= _LARGEST for side in shapes.get("memory", [None]))
        if set(shapes) != {"wrench", "memory"} or shapes["wrench"] != [1, 1, 6] or not sized:
            raise InputError(
                f"{name}: has the inputs {shapes}, but a network for an angle from wrenches has the inputs "
                f"'wrench' (1, 1, 6) and 'memory': make one with {_HOW} toskov"
            )
        self._session, self._name = session, name
        self._shape = tuple(int(side) for side in shapes["memory"])

    def blank(self) -> Memory:
        """Return the memory before the first step."""
        return np.zeros(self._shape, np.float32)

    def step(self, wrench: Wrench, memory: Memory) -> tuple[float, Memory]:
        """Return the rotation of the object, deg, after a step (6,), and the new memory."""
        answers = run_model(self._session, self._name, {"wrench": wrench[None, None], "memory": memory})
        if len(answers) != 2 or answers[1].shape != self._shape or not answers[0].size:
            raise InputError(
                f"{self._name}: its outputs are not an angle and the memory: make one with {_HOW} toskov"
            )
        return float(answers[0].reshape(-1)[0]), answers[1]


def load_image_network(file: Path | None = None) -> ImageAngleNetwork:
    """Load the rig's AngleNet, or one from a file. Raises `InputError`."""
    session, name = _opened("anglenet", file)
    return ImageAngleNetwork(session, name)


def load_wrench_network(file: Path | None = None) -> WrenchAngleNetwork:
    """Load the rig's network after Toskov et al., or one from a file. Raises `InputError`."""
    session, name = _opened("toskov", file)
    return WrenchAngleNetwork(session, name)


def _opened(shipped: str, file: Path | None) -> tuple[onnxruntime.InferenceSession, str]:
    if file is not None and not file.is_file():
        raise InputError(f"{file}: file not found: make it with {_HOW} {shipped} --out FOLDER")
    with as_file(MODELS / f"{shipped}.onnx") as path:
        return open_model(file or path, 1, f"{_HOW} {shipped}"), str(file or shipped)
