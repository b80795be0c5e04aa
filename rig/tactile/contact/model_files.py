"""ONNX files: where the shipped ones lie, and how one is opened."""

from importlib.resources import files
from pathlib import Path

import onnxruntime

from drivers.errors import InputError

MODELS = files("rig") / "models"


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
    try:
        return onnxruntime.InferenceSession(path.read_bytes(), options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its exceptions share no base class of their own
        reason = str(error).splitlines()[0][:120]
        raise InputError(
            f"{path}: is no complete ONNX network ({reason}): copy it anew, or make one with {how}"
        ) from error
