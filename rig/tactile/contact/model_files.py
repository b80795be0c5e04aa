"""Open and run the networks in ONNX files."""

from collections.abc import Mapping
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from drivers.errors import InputError, RigError
from drivers.formats import read_bounded, reason

MOST_BYTES = 1_000_000_000
"""Largest size of an ONNX file that is read."""
MODELS = files("rig") / "models"
"""Folder of the rig's own networks."""


def run_model(
    session: onnxruntime.InferenceSession, name: str, fed: Mapping[str, NDArray[Any]]
) -> list[NDArray[np.float32]]:
    """Return the outputs of a network.

    name: of the network, for messages. fed: inputs by name. Raises `InputError` if the network fails, or if
    an output is NaN or infinite.
    """
    try:
        answers = [np.asarray(answer, np.float32) for answer in session.run(None, dict(fed))]
    except RigError:  # a stop by the operator
        raise
    except Exception as error:  # the exceptions of onnxruntime have no common base class
        raise InputError(f"{name}: fails when it is run ({reason(error)}): export it again") from error
    if not all(np.isfinite(answer).all() for answer in answers):
        raise InputError(f"{name}: its output has NaN or infinite values: export it again")
    return answers


def open_model(path: Path, threads: int, how: str) -> onnxruntime.InferenceSession:
    """Open an ONNX file for inference on the CPU.

    threads: threads per inference; the output does not depend on it. how: command that makes such a
    file, for messages. Raises `InputError` if the file is damaged or not an ONNX network.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # errors are raised as exceptions; without this onnxruntime would also print them on stderr
    options.log_severity_level = 4
    data = read_bounded(path, MOST_BYTES)
    try:
        return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except RigError:  # a stop by the operator
        raise
    except Exception as error:  # the exceptions of onnxruntime have no common base class
        raise InputError(
            f"{path}: is not a complete ONNX network ({reason(error)}): copy it again, or make one with {how}"
        ) from error
