"""Predict which texture of a contact rotates with the object, with a network, from one image.

Lines, edges and marks of the object rotate; the rim of a bulge, specks of the gel and blocks of a codec do
not. A small network, trained on simulated contacts (`tools/train_turning.py`), separates them by their
appearance, before any motion.
"""

from functools import cache
from importlib.resources import as_file
from pathlib import Path

import cv2
import numpy as np
import onnxruntime
from numpy.typing import NDArray

from drivers.errors import InputError
from rig.tactile.contact.model_files import MODELS, open_model, run_model
from rig.tactile.slip.height import Field
from rig.tactile.slip.parameters import KEYFRAMES
from rig.tactile.slip.texture import FINENESS

# Side of the squares that the network predicts, px, and the multiple of px that its input has as sides.
SHARE_PX, MULTIPLE_PX = 2, 16
SHIPPED = "turning.onnx"
_HOW = "python tools/train_turning.py"


class TurningNetwork:
    """Predicts the fraction of the texture of an image that rotates."""

    def __init__(self, session: onnxruntime.InferenceSession, name: str) -> None:
        entries, answers = session.get_inputs(), session.get_outputs()
        fits = len(entries) == 1 and len(answers) == 1 and list(entries[0].shape)[:2] == [1, 3]
        if not fits or len(entries[0].shape) != 4 or list(answers[0].shape)[:2] != [1, 1]:
            raise InputError(
                f"{name}: maps {[list(e.shape) for e in entries]} to {[list(a.shape) for a in answers]}, not "
                f"one input (1, 3, h, w) to one answer (1, 1, h / 2, w / 2): make it with {_HOW}"
            )
        self._session, self._name, self._key = session, name, entries[0].name

    def share(self, difference: Field) -> NDArray[np.float32]:
        """Return the rotating fraction, 0 to 1, of a relative difference (h, w, 3), per `SHARE_PX` square."""
        return self.share_of(difference.transpose(2, 0, 1))

    def share_of(self, difference: Field) -> NDArray[np.float32]:
        """Return the same of planes (3, h, w)."""
        height, width = difference.shape[1:]
        fed = np.zeros((1, 3, height + -height % MULTIPLE_PX, width + -width % MULTIPLE_PX), np.float32)
        fed[0, :, :height, :width] = difference
        logits = run_model(self._session, self._name, {self._key: fed})[0][0, 0]
        logits = logits[: -(-height // SHARE_PX), : -(-width // SHARE_PX)]
        return np.asarray(1.0 / (1.0 + np.exp(-logits)), np.float32)

    def counts(self, difference: Field, scale: int) -> Field:
        """Return the weight of the texture of each pixel, (h, w), `least_count` to 1.

        difference: (3, h, w), with `scale` pixels per work pixel.
        """
        height, width = difference.shape[1:]
        if scale != FINENESS:  # the network was trained on this resolution
            size = (FINENESS * width // scale, FINENESS * height // scale)
            difference = np.stack([cv2.resize(plane, size) for plane in difference])
        turning = (self.share_of(difference) - KEYFRAMES.resting) / (KEYFRAMES.turning - KEYFRAMES.resting)
        counts = KEYFRAMES.least_count + (1.0 - KEYFRAMES.least_count) * np.clip(turning, 0.0, 1.0)
        return np.asarray(cv2.resize(counts, (width, height)), np.float32)


def load_turning(path: Path) -> TurningNetwork:
    """Load a network. Raises `InputError` if the file is missing, damaged or another kind of network."""
    return TurningNetwork(open_model(path, 1, _HOW), path.name)


@cache
def shipped_turning() -> TurningNetwork:
    """Return the network that comes with the product."""
    with as_file(MODELS / SHIPPED) as path:
        return load_turning(path)
