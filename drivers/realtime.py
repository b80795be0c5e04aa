"""Keeping deadlines on a loaded host, and in an interpreter that collects garbage."""

import gc
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

LOWEST_REAL_TIME = 1


def ask_for_realtime() -> None:
    """Ask for the lowest real-time priority for this process's threads and what they start from now on.

    All of them: one that has the interpreter and gets no core keeps the others waiting. Granted to root, and
    to users with an `rtprio` limit (/etc/security/limits.conf); elsewhere nothing changes. Only for threads
    that sleep most of the time: they run before everything else.
    Garbage collection no longer looks at the objects that exist now; a pass over them takes up to 0.1 s.
    """
    _come_first()
    _keep_from_collection()


@contextmanager
def realtime() -> Iterator[None]:
    """Run the block at real-time priority, without garbage collection of what exists now."""
    with before_others():
        _keep_from_collection()
        try:
            yield
        finally:
            gc.unfreeze()


@contextmanager
def before_others() -> Iterator[None]:
    """Run the block at real-time priority, where that is granted; threads started in it keep theirs."""
    before = _come_first()
    try:
        yield
    finally:
        for thread, policy in before.items():
            _schedule(thread, policy, 0)


def _come_first() -> dict[int, int]:
    """Ask for real-time priority for the threads without it; return them and how they were scheduled."""
    threads = _ordinary_threads()
    for thread in threads:
        _schedule(thread, os.SCHED_RR, LOWEST_REAL_TIME)
    return threads


def _keep_from_collection() -> None:
    gc.collect()
    gc.freeze()


def _ordinary_threads() -> dict[int, int]:
    """Return the interpreter's own threads without real-time priority, and how they are scheduled.

    None where a system has no such priority.
    """
    if not hasattr(os, "sched_getscheduler"):
        return {}
    found: dict[int, int] = {}
    for thread in filter(None, (thread.native_id for thread in threading.enumerate())):
        with suppress(OSError):  # it has ended just now
            policy = os.sched_getscheduler(thread)
            if policy not in (os.SCHED_RR, os.SCHED_FIFO):
                found[thread] = policy
    return found


def _schedule(thread: int, policy: int, priority: int) -> None:
    with suppress(OSError):  # not allowed, or ended
        os.sched_setscheduler(thread, policy, os.sched_param(priority))


@contextmanager
def ordinary() -> Iterator[None]:
    """Run the block at ordinary priority: for what may wait by computing, as libraries do.

    At real-time priority such a wait takes a core from everything else, also from what it waits for.
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
    """Keep OpenCV and BLAS from starting threads of their own, for the rest of the program.

    On a loaded host such threads get no core, and a lift waits for them: a frame took up to 3 s. And the last
    digits of a matrix product depend on how many threads share it: a replay gives the results of its lift bit
    for bit only with the same number.
    """
    import cv2
    from threadpoolctl import threadpool_limits

    cv2.setNumThreads(1)
    threadpool_limits(1)
