"""Program of `rig benchmark slip`: run an estimator of one version of the slip rig in a separate process.

The version is the one in PYTHONPATH. Therefore the program uses only names that earlier versions also have.
The first line on stdout is the folder of that version. Then each line on stdin is a request, a JSON list of
the name of a function in `JOBS` and its arguments; the answer is a line of JSON.
"""

import json
import os
import sys
import time
from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np

import rig


def contact_times(estimator: str, file: str) -> list[float | None]:
    """Return the CPU time of each frame in ms, over all threads; None for a frame without contact.

    It is the time of `rig.estimator(...).update`, with all checks of a stream.
    """
    of = np.load(file)
    aspect = float(of["aspect"]) or None
    made = rig.estimator(estimator, background=of["background"], pixel_aspect=aspect, sign=int(of["sign"]))
    found: list[float | None] = []
    for image, time_ns in zip(of["images"], of["times_ns"].tolist(), strict=True):
        began = time.process_time()
        sample = made.update(image, time_ns / 1e9)
        spent_ms = 1e3 * (time.process_time() - began)
        touching = sample.state.value != "no_contact" and not getattr(sample, "jumped", False)
        found.append(spent_ms if touching else None)
    return found


def stream(estimator: str, streams: list[list[str]], rate_hz: float) -> list[float]:
    """Estimate the frames of several streams in real time, at real-time priority if it is permitted.

    streams: files of each stream, shown one after the other, each with a new estimator. rate_hz: of
    the frames of each stream. A frame that still waits when the next one of its stream arrives is dropped.
    Returns the numbers of frames and of dropped frames, and the longest time in ms from the arrival of a
    frame to its angle.
    """
    shown = [[frame for file in files for frame in _shown(estimator, file)] for files in streams]
    frames = [(i / rate_hz, *one) for i, row in enumerate(zip(*shown, strict=False)) for one in row]
    with suppress(AttributeError, PermissionError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    delays_s, began = [], time.perf_counter()
    for arrives_s, made, image in frames:
        late_s = time.perf_counter() - began - arrives_s
        if late_s <= 1.0 / rate_hz:
            time.sleep(max(0.0, -late_s))
            made.update(image, arrives_s)
            delays_s.append(time.perf_counter() - began - arrives_s)
    return [len(frames), len(frames) - len(delays_s), 1e3 * max(delays_s, default=0.0)]


def _shown(estimator: str, file: str) -> list[tuple["rig.StreamingEstimator", np.ndarray]]:
    of = np.load(file)
    made = rig.estimator(estimator, background=of["background"])
    return [(made, image) for image in of["images"]]


JOBS = {"contact_times": contact_times, "stream": stream}


def main() -> None:
    answers, sys.stdout = sys.stdout, sys.stderr
    cv2.setNumThreads(1)
    with suppress(AttributeError):  # not on every operating system
        os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    print(json.dumps(str(Path(rig.__file__).parents[1])), file=answers, flush=True)
    for line in sys.stdin:
        job, *arguments = json.loads(line)
        print(json.dumps(JOBS[job](*arguments)), file=answers, flush=True)


if __name__ == "__main__":
    main()
