"""Run simulated lifts in parallel: worker processes end with their parent, however it ends."""

import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from typing import TypeVar

from drivers.children import end_with_parent, leave_signals_to_parent, spawn_context
from drivers.errors import RigError

Task = TypeVar("Task")
Result = TypeVar("Result")


def run_tasks(
    work: Callable[[Task], Result], tasks: list[Task], jobs: int, fork: bool = False
) -> Iterator[tuple[Task, Result]]:
    """Yield results as they finish; with one job, in this process and in order.

    `tasks` may grow during the iteration (a lift to repeat). If the loop is left early, the workers are
    terminated at once: they write recordings only under unfinished names, and no results. fork: workers start
    as copies of this process, which then must not have other threads; they need not import its modules again.
    """
    if jobs == 1:
        while tasks:
            task = tasks.pop(0)
            yield task, work(task)
        return
    context = multiprocessing.get_context("fork") if fork else spawn_context()
    others = multiprocessing.active_children()
    pool = ProcessPoolExecutor(jobs, mp_context=context, initializer=_end_with_parent)
    running: dict[Future[Result], Task] = {}
    try:
        while tasks or running:
            # One queued task per worker keeps it busy; more would hold results in memory.
            while tasks and len(running) < 2 * jobs:
                task = tasks.pop(0)
                running[pool.submit(work, task)] = task
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                yield running.pop(future), future.result()
    except BrokenExecutor as error:
        raise RigError(
            "a worker process died (out of memory?); finished lifts are kept: continue with --resume, "
            "and with fewer --jobs if it happens again"
        ) from error
    finally:
        # Workers write no results, so they can be terminated at once without damaging any.
        for process in multiprocessing.active_children():
            if process not in others:  # e.g. the process of a page outlives the pool
                process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)


def _end_with_parent() -> None:
    """Leave signals to the parent, and exit when it has ended. A fork has the command line's handlers."""
    leave_signals_to_parent()
    end_with_parent()
