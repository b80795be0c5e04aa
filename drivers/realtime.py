"""Keeping deadlines on a busy computer, and in an interpreter that collects garbage."""

import gc
import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress

LOWEST_REAL_TIME = 1


def ask_for_realtime() -> None:
    """Ask for the lowest real-time priority for this thread and what it starts from now on.

    Granted to root, and to users with an `rtprio` limit (/etc/security/limits.conf); elsewhere
    nothing changes. Only for threads that sleep most of the time: they run before everything else.
    Garbage collection no longer looks at the objects that exist now; a pass over them takes up to 0.1 s.
    """
    with suppress(OSError, AttributeError):  # not allowed, or a system without it
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(LOWEST_REAL_TIME))
    gc.collect()
    gc.freeze()


@contextmanager
def realtime() -> Iterator[None]:
    """Run the block at real-time priority; threads started in it keep theirs."""
    ask_for_realtime()
    try:
        yield
    finally:
        gc.unfreeze()
        with suppress(OSError, AttributeError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


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
