"""Simulated lifts side by side: worker processes that end with their parent, whatever ends it."""

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
    """Yield results as they come; with one job, in this process and in order.

    `tasks` may grow while results are taken (a lift to repeat). Leaving the loop early ends the workers at
    any moment: they write recordings under unfinished names, and no results. fork: workers begin as copies of
    this process, which must have no other thread then; so they need not import all that it has imported.
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
            # One task ahead per worker keeps it busy; more would hold results in memory.
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
        # Workers write no results, so they can be ended at once without damaging any.
        for process in multiprocessing.active_children():
            if process not in others:  # as the process of a page, which outlives the pool
                process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)


def _end_with_parent() -> None:
    """Leave signals to the parent, and exit when it is gone. A fork has the command line's handlers."""
    leave_signals_to_parent()
    end_with_parent()
