"""Real-time scheduling, so that deadlines are kept on a loaded host and during garbage collection."""

import gc
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

LOWEST_REAL_TIME = 1
"""Lowest priority of the Linux policy SCHED_RR (`man 7 sched`)."""


def ask_for_realtime() -> dict[int, int]:
    """Request the lowest real-time priority for all threads of this process and those they start later.

    It covers all threads, because a thread that holds the interpreter lock and gets no core blocks the
    others. Granted to root, and to users with an `rtprio` limit (/etc/security/limits.conf); otherwise
    nothing changes. Use it only for threads that sleep most of the time: they run before everything else.
    Objects that exist now are excluded from garbage collection, because a pass over them takes up to 0.1 s.
    Returns the native ids of the threads that had no such priority, with their scheduling policies; empty if
    the operating system has no such priority.
    """
    found: dict[int, int] = {}
    if hasattr(os, "sched_getscheduler"):
        for thread in filter(None, (thread.native_id for thread in threading.enumerate())):
            with suppress(OSError):  # the thread has just ended
                policy = os.sched_getscheduler(thread)
                if policy not in (os.SCHED_RR, os.SCHED_FIFO):
                    found[thread] = policy
                    _schedule(thread, os.SCHED_RR, LOWEST_REAL_TIME)
    gc.collect()
    gc.freeze()
    return found


@contextmanager
def realtime() -> Iterator[None]:
    """Run the block at real-time priority, with existing objects excluded from garbage collection.

    Threads that are started in the block keep their priority.
    """
    before = ask_for_realtime()
    try:
        yield
    finally:
        gc.unfreeze()
        for thread, policy in before.items():
            _schedule(thread, policy, 0)


def _schedule(thread: int, policy: int, priority: int) -> None:
    with suppress(OSError):  # not permitted, or the thread has ended
        os.sched_setscheduler(thread, policy, os.sched_param(priority))


@contextmanager
def ordinary() -> Iterator[None]:
    """Run the block at ordinary priority. For calls that may busy-wait, as some libraries do.

    At real-time priority a busy-wait takes a core from all other threads, also from the one it waits for.
    """
    policy = os.sched_getscheduler(0) if hasattr(os, "sched_getscheduler") else None
    if policy is None or policy != os.SCHED_RR:
        yield
        return
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, policy, os.sched_param(LOWEST_REAL_TIME))


def compute_in_one_thread() -> None:
    """Keep OpenCV and BLAS from starting threads, for the rest of the program.

    On a loaded host such threads get no core and a lift waits for them: a frame took up to 3 s. Also, the
    last digits of a matrix product depend on the number of threads: a replay reproduces the results of its
    lift bit for bit only with the same number.
    """
    import cv2
    from threadpoolctl import threadpool_limits

    cv2.setNumThreads(1)
    threadpool_limits(1)
