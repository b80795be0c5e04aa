"""Open and run the networks in ONNX files."""

import re
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
from numpy.typing import NDArray

from drivers.errors import InputError, RigError
from drivers.formats import MOST_NETWORK, check_onnx, read_bounded, reason

MOST_BYTES = 1_000_000_000
"""Largest size of an ONNX file that is read."""
_ARENA = "bfc_arena.cc"
"""Part of onnxruntime's message if the memory limit is reached."""
_NEWER = re.compile(r"Unsupported model IR version: (\d+), max supported IR version: (\d+)")
"""Its message for a file of a newer version."""
MODELS = files("rig") / "models"
"""Folder of the rig's own networks."""


def run_model(
    session: onnxruntime.InferenceSession, name: str, fed: Mapping[str, NDArray[Any]]
) -> list[NDArray[np.float32]]:
    """Return the outputs of a network.

    name: of the network, for messages. fed: inputs by name. Raises `InputError` if the network fails or needs
    more memory than `MOST_NETWORK`, or if an output is NaN or infinite.
    """
    try:
        answers = [np.asarray(answer, np.float32) for answer in session.run(None, dict(fed))]
    except RigError:  # a stop by the operator
        raise
    except Exception as error:  # the exceptions of onnxruntime have no common base class
        if _ARENA in str(error):
            most = f"{MOST_NETWORK / 1e9:.0f} GB"
            raise InputError(f"{name}: needs more than {most} of memory: use smaller images") from error
        raise InputError(f"{name}: fails when it is run ({reason(error)}): export it again") from error
    if not all(np.isfinite(answer).all() for answer in answers):
        raise InputError(f"{name}: its output has NaN or infinite values: export it again")
    return answers


def open_model(path: Path, threads: int, how: str) -> onnxruntime.InferenceSession:
    """Open an ONNX file for inference on the CPU.

    threads: threads per inference; the output does not depend on it. how: command that makes such a
    file, for messages. Raises `InputError` if the file is damaged, not an ONNX network, or declares tensors
    that are too large.
    """
    _limit_memory()
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    # errors are raised as exceptions; without this onnxruntime would also print them on stderr
    options.log_severity_level = 4
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.add_session_config_entry("session.load_model_format", "ONNX")  # no other format is checked
    options.add_session_config_entry("session.model_external_initializers_file_folder_path", str(path.parent))
    data = read_bounded(path, MOST_BYTES)
    check_onnx(path, data)
    try:
        return onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except RigError:  # a stop by the operator
        raise
    except Exception as error:  # the exceptions of onnxruntime have no common base class
        if newer := _NEWER.search(str(error)):
            raise InputError(
                f"{path}: has version {newer[1]} of ONNX's format, and this onnxruntime reads up to "
                f"{newer[2]}: update onnxruntime, or export the network with an older version of onnx"
            ) from error
        raise InputError(
            f"{path}: is not a complete ONNX network ({reason(error)}): copy it again, or make one with {how}"
        ) from error


@cache
def _limit_memory() -> None:
    """Limit the memory of all networks of this process that use onnxruntime's shared allocator."""
    kind = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR
    cpu = onnxruntime.OrtMemoryInfo("Cpu", kind, 0, onnxruntime.OrtMemType.DEFAULT)
    onnxruntime.create_and_register_allocator(cpu, onnxruntime.OrtArenaCfg({"max_mem": MOST_NETWORK}))
