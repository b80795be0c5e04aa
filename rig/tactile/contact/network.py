"""Run a segmentation network in an ONNX file with onnxruntime.

The metadata of the file states the network's input and the threshold of its output (`rig train` and `rig
model import` write them). If they are missing, the input follows from the number of channels: three are the
frame, six the difference and the frame.

`frame`: the image, scaled to 0..1, as in the paper (section III-A). `frame+difference`: the relative
difference from the frame without contact (`rig.tactile.contact.relative`), followed by the image. The
difference is similar for all sensors; the image shows the direction of the light.
"""

import json
from dataclasses import dataclass
from enum import Enum
from importlib.resources import as_file
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from drivers.errors import FormatError, InputError
from drivers.formats import parse_json, quote, reason
from drivers.types import Image
from rig.tactile.contact.model_files import MODELS, open_model, run_model
from rig.tactile.contact.relative import RelativeDifference

Planes = NDArray[np.float32]

MOST_DIFFERENCE = 2.0
"""Relative differences are clipped to this: bright spots on a dark background are not stronger contacts."""
MIDDLE_GREY = 0.3
"""Subtracted from the image: approximately the mean of a DIGIT's frame on a scale of 0 to 1."""


class NetworkInput(Enum):
    """Kind of input of a network; the values are used in model cards."""

    FRAME = "frame"
    FRAME_AND_DIFFERENCE = "frame+difference"

    @property
    def channels(self) -> int:
        """Number of planes."""
        return 3 if self is NetworkInput.FRAME else 6


def frame_planes(image: Image, size: tuple[int, int]) -> Planes:
    """Return (3, h, w) float32, 0 to 1, from an (H, W, 3) uint8 RGB frame. size: (width, height) in px."""
    small = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    return np.ascontiguousarray(small.transpose(2, 0, 1), np.float32) / np.float32(255.0)


def compared_planes(image: Image, reference: RelativeDifference) -> Planes:
    """Return (6, h, w) float32 from an (H, W, 3) uint8 RGB frame: the relative difference, then the image."""
    small = reference.reduce(image)
    planes = np.empty((6, *small.shape[:2]), np.float32)
    np.clip(reference.of(small).transpose(2, 0, 1), -MOST_DIFFERENCE, MOST_DIFFERENCE, out=planes[:3])
    np.multiply(small.transpose(2, 0, 1), np.float32(1.0 / 255.0), out=planes[3:])
    planes[3:] -= np.float32(MIDDLE_GREY)
    return planes


SHIPPED = ("ours", "ours-full", "pspnet")
HOW = "rig train or rig model import"
METADATA_KEY = "rig"
PAPER_THRESHOLD = 0.7
MIN_SIDE_PX, MAX_SIDE_PX = 16, 4096
_FLOATS = {"tensor(float)": np.float32, "tensor(float16)": np.float16}


@dataclass(frozen=True, slots=True)
class Recipe:
    """How a network is used.

    inputs: kind of input. threshold: a pixel is contact if its sigmoid output is above this. convex: whether
    the network was trained on labels with convex parts (`rig.labels.polygons`), so that parts of a mask are
    replaced by their hulls.
    """

    inputs: NetworkInput
    threshold: float
    convex: bool = False

    def metadata(self) -> str:
        """Return the text of the metadata in an ONNX file."""
        return json.dumps({"inputs": self.inputs.value, "threshold": self.threshold, "convex": self.convex})


class Network:
    """A network that is ready to run. size: (width, height) of its input in px."""

    def __init__(self, session: onnxruntime.InferenceSession, name: str) -> None:
        self._session, self.name = session, name
        entry = _checked_entry(session, name)
        self._key, self._dtype = entry.name, _FLOATS[entry.type]
        self.size = (int(entry.shape[3]), int(entry.shape[2]))
        self.recipe = _recipe(session, int(entry.shape[1]), name)

    def logits(self, planes: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the logits (h, w) float32 for planes (C, h, w) float32; they are positive for contact.

        Raises `InputError` if the network fails.
        """
        fed = planes[None].astype(self._dtype, copy=False)
        answer = run_model(self._session, self.name, {self._key: fed})[0]
        if answer.shape != (1, 1, *planes.shape[1:]):
            raise InputError(
                f"{self.name}: its output has the shape {list(answer.shape)}, not the one it declares: "
                "export it again"
            )
        return answer[0, 0]


def load_network(name: str | Path, threads: int = 1) -> Network:
    """Load a network of the rig by its name, or an ONNX file.

    threads: threads per inference; the output does not depend on it. Raises `InputError` if the file is
    missing, damaged or not a segmentation network.
    """
    with as_file(MODELS / f"{name}.onnx") as shipped:
        path = shipped if str(name) in SHIPPED else Path(name)
        if not path.is_file():
            raise InputError(
                f"{name}: network not found: give {' or '.join(SHIPPED)}, or the path of an ONNX file"
            )
        return Network(open_model(path, threads, HOW), str(name))


def _checked_entry(session: onnxruntime.InferenceSession, name: str) -> Any:
    """Return the input of a network. Raises `InputError` unless it maps (1, 3 or 6, h, w) to (1, 1, h, w)."""
    entries, answers = session.get_inputs(), session.get_outputs()
    if not entries or not answers:
        raise InputError(f"{name}: has no input or no output: export it again")
    entry, answer = entries[0], answers[0]
    shape = list(entry.shape)
    good = (
        len(entries) == 1
        and entry.type in _FLOATS
        and len(shape) == 4
        and not (isinstance(shape[0], int) and shape[0] != 1)
        and shape[1] in (3, 6)
        and all(isinstance(side, int) and MIN_SIDE_PX <= side <= MAX_SIDE_PX for side in shape[2:])
        and list(answer.shape)[1:] == [1, *shape[2:]]
    )
    if not good:
        raise InputError(
            f"{name}: maps {entry.type} {shape} to {list(answer.shape)}, but a segmentation network maps "
            "float (1, 3 or 6, h, w) to (1, 1, h, w)"
        )
    return entry


def _recipe(session: onnxruntime.InferenceSession, channels: int, name: str) -> Recipe:
    text = session.get_modelmeta().custom_metadata_map.get(METADATA_KEY)
    by_channels = NetworkInput.FRAME if channels == 3 else NetworkInput.FRAME_AND_DIFFERENCE
    if text is None:
        return Recipe(by_channels, PAPER_THRESHOLD)
    try:
        card = parse_json(text.encode(), "it")
        recipe = Recipe(
            NetworkInput(card["inputs"]), float(card["threshold"]), bool(card.get("convex", False))
        )
    except (FormatError, ValueError, KeyError, TypeError, OverflowError) as error:
        raise InputError(f"{name}: its metadata cannot be read ({reason(error)}): export it again") from error
    if recipe.inputs is not by_channels or not 0.0 < recipe.threshold < 1.0:
        raise InputError(
            f"{name}: its metadata ({quote(text)}) does not fit {channels} channels: export it again"
        )
    return recipe
