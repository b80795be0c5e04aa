"""Run time of estimators of this and of other versions of the slip rig, with the same frames and Python.

Each runs in its process (`rig.benchmark.slip.contender`), and only one of them computes at a time.
"""

import json
import os
import subprocess
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from drivers.children import python_command
from drivers.errors import InputError, RigError
from drivers.types import Image
from rig.benchmark.slip import contender
from rig.frames.estimates import TimedImage

OWN = Path(__file__).resolve().parents[3]
"""Folder of this version."""
ROUNDS = 2
"""Each frame is timed this often, and its shortest time counts: other programs can only lengthen it."""
FRAMES = 600
"""Largest number of frames per file, 10 s of a lift, as in `rig benchmark estimators`."""


def store(
    file: Path, background: Image, frames: Iterable[TimedImage], aspect: float | None = None, sign: int = 1
) -> None:
    """Store the first frames of a series, uncompressed, for the processes of all versions."""
    shown = [(of.time_ns, of.image) for of in islice(frames, FRAMES) if of.image is not None]
    times_ns, images = zip(*shown, strict=True)
    sensor = {"background": background, "aspect": aspect or 0.0, "sign": sign}
    np.savez(file, images=np.stack(images), times_ns=np.array(times_ns, np.int64), **sensor)


class Contender:
    """The process of an estimator of one version. folder: contains the version's package `rig`.

    name: the estimator, and the folder of another version. Raises `InputError` if there is no version in the
    folder, and `RigError` if the process ends.
    """

    def __init__(self, estimator: str, folder: Path) -> None:
        folder = folder.resolve()
        self.name = estimator if folder == OWN else f"{estimator} in {folder.name}"
        self.other_version, self._estimator = folder != OWN, estimator
        if not (folder / "rig" / "tactile" / "estimators.py").is_file():
            raise InputError(f"{folder}: holds no slip rig: give the folder with its package 'rig'")
        threads = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
        self._process = subprocess.Popen(  # noqa: S603, this Python with a file of this package
            python_command(contender.__file__),
            env={**os.environ, **threads, "PYTHONPATH": str(folder)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,  # Ctrl-C is for this process, which then ends that one
        )
        if (found := Path(self._answer())) != folder:
            self.close()
            raise RigError(f"{folder}: Python imports the slip rig in {found} instead")

    def ask(self, job: str, *arguments: Any) -> Any:
        """Return the answer of a function of `contender`. Raises `RigError` if the process has ended."""
        with suppress(BrokenPipeError):  # the answer is then missing
            print(json.dumps([job, self._estimator, *arguments]), file=self._process.stdin, flush=True)
        return self._answer()

    def _answer(self) -> Any:
        line = self._process.stdout.readline() if self._process.stdout else ""
        if not line:
            self.close()
            raise RigError(f"{self.name}: the process of this estimator has ended; its message is above")
        return json.loads(line)

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()


def contact_ms(
    of: Sequence[Contender],
    files: Sequence[Path],
    progress: Callable[[int, int, str], None] = lambda *_: None,
) -> list[list[float]]:
    """Return each contender's CPU times of the frames with contact, by its own detection, in ms.

    The contenders run in turn on each file, in an order that rotates. progress: see `Run`.
    """
    spent: list[list[float]] = [[] for _ in of]
    for number, file in enumerate(files):
        rounds: list[list[list[float | None]]] = [[] for _ in of]
        for turn in range(number, number + ROUNDS * len(of)):
            place = turn % len(of)
            rounds[place].append(of[place].ask("contact_times", str(file)))
        for times_ms, runs in zip(spent, rounds, strict=True):
            times_ms += [min(ms) for frame in zip(*runs, strict=True) if (ms := [m for m in frame if m])]
        progress(number + 1, len(files), f"time on {file.stem}")
    return spent
