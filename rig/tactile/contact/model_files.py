"""ONNX files: where the shipped ones lie, and how one is opened."""

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
MODELS = files("rig") / "models"


def run_model(
    session: onnxruntime.InferenceSession, name: str, fed: Mapping[str, NDArray[Any]]
) -> list[NDArray[np.float32]]:
    """Return a network's answers. Raises `InputError` for one that fails, or answers what is no number."""
    try:
        answers = [np.asarray(answer, np.float32) for answer in session.run(None, dict(fed))]
    except RigError:  # a stop that came meanwhile
        raise
    except Exception as error:  # its exceptions share no base class of their own
        raise InputError(f"{name}: fails when it is run ({reason(error)}): export it again") from error
    if not all(np.isfinite(answer).all() for answer in answers):
        raise InputError(f"{name}: answers what is no number: export it again")
    return answers


def open_model(path: Path, threads: int, how: str) -> onnxruntime.InferenceSession:
    """Open an ONNX file on the processor.

    threads: of one inference; the answer does not depend on it. how: the command that makes such a
    file. Raises `InputError` for a file that is cut or no ONNX network.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # errors are raised; its own lines on stderr would say them twice
    options.log_severity_level = 4
    data = read_bounded(path, MOST_BYTES)
    try:
        return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except RigError:  # a stop that came meanwhile
        raise
    except Exception as error:  # its exceptions share no base class of their own
        raise InputError(
            f"{path}: is no complete ONNX network ({reason(error)}): copy it anew, or make one with {how}"
        ) from error
