"""Run work in parallel: in worker processes that end with their parent, or on a running dask cluster.

The workers of the cluster need this product installed and see the sessions under the same paths.
"""

import multiprocessing
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, ProcessPoolExecutor, wait
from functools import partial
from typing import TypeVar

from drivers.children import end_with_parent, leave_signals_to_parent, spawn_context
from drivers.errors import InputError, RigError
from drivers.progress import show_on, steps
from rig.tactile.slip.compiling import is_compiling

Task = TypeVar("Task")
Result = TypeVar("Result")
COMPILING_POLL_S = 0.1
"""Time between two checks whether the loops are compiled."""


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
            # One queued task per worker keeps it busy; more would hold results in memory. While another
            # process compiles, one worker starts alone: further ones would delay both, and then wait.
            compiling = is_compiling()
            while tasks and len(running) < (1 if compiling else 2 * jobs):
                task = tasks.pop(0)
                running[pool.submit(work, task)] = task
            for future in wait(running, COMPILING_POLL_S if compiling else None, FIRST_COMPLETED).done:
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


def run_in_order(work: Callable[[Task], Result], tasks: Sequence[Task], jobs: int) -> Iterator[Result]:
    """Yield the results of all tasks in their order, and count finished tasks on the progress display.

    Workers are forks of this process while it has no other thread, because a fork copies no thread. With
    several jobs the caller must have called `compute_in_one_thread`.
    """
    fork, jobs = threading.active_count() == 1, max(1, min(jobs, len(tasks)))
    results = run_tasks(partial(_run_numbered, work), list(enumerate(tasks)), jobs, fork)
    early: dict[int, Result] = {}
    next_one = 0
    for _, (number, result) in steps(results, len(tasks)):
        early[number] = result
        while next_one in early:
            yield early.pop(next_one)
            next_one += 1


def _run_numbered(work: Callable[[Task], Result], task: tuple[int, Task]) -> tuple[int, Result]:
    return task[0], work(task[1])


def _end_with_parent() -> None:
    """Leave signals and progress to the parent, and exit when it has ended. A fork has copies of both."""
    show_on(None)
    leave_signals_to_parent()
    end_with_parent()


SCHEME = "dask://"
CONNECT_TIMEOUT_S = 10
"""Time limit for connecting to the scheduler."""


def engine_address(engine: str) -> str:
    """Return the scheduler's address of `dask://HOST:PORT`. Raises `InputError` for anything else."""
    host, _, port = engine.removeprefix(SCHEME).rpartition(":")
    if not engine.startswith(SCHEME) or not host or not port.isdigit():
        raise InputError(f"--engine {engine}: give dask://HOST:PORT of a running dask scheduler")
    return f"tcp://{host}:{port}"


def runner(
    engine: str | None, jobs: int
) -> Callable[[Callable[[Task], Result], list[Task]], Iterator[tuple[Task, Result]]]:
    """Return a function that executes tasks: in `jobs` processes of this computer, or on a cluster.

    It yields each task with its result. Raises `InputError` for an invalid engine.
    """
    if engine is None:
        return lambda work, tasks: run_tasks(work, tasks, jobs)
    engine_address(engine)
    return lambda work, tasks: run_on_cluster(engine, work, tasks)


def run_on_cluster(
    engine: str, work: Callable[[Task], Result], tasks: Sequence[Task]
) -> Iterator[tuple[Task, Result]]:
    """Yield tasks and results as the cluster's workers finish, in any order.

    The tasks of a worker that is lost are done again by another one. Raises `InputError` if the cluster does
    not answer or the library is missing, and `RigError` for a task that has ended several workers.
    """
    try:
        from distributed import Client, KilledWorker, as_completed
    except ImportError as error:
        raise InputError('--engine needs dask: pip install "visuotactile-slip-rig[cluster]"') from error
    address = engine_address(engine)
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    try:
        # Raises immediately if the scheduler is not listening; dask would retry until its time-out.
        socket.create_connection((host.strip("[]"), int(port)), CONNECT_TIMEOUT_S).close()
        client = Client(address, timeout=CONNECT_TIMEOUT_S)
    except (OSError, TimeoutError) as error:
        raise InputError(
            f"--engine: no dask scheduler answers at {address} ({error}); start one with `dask scheduler`"
        ) from error
    with client:
        if not client.scheduler_info()["workers"]:
            raise InputError(
                f"--engine: the cluster at {address} has no workers; start some with `dask worker`"
            )
        running = dict(zip(client.map(work, tasks, pure=False), tasks, strict=True))
        for future in as_completed(list(running)):
            try:
                yield running.pop(future), future.result()
            except KilledWorker as error:
                raise RigError(
                    f"--engine: a task has ended several workers of {address} (out of memory?); finished "
                    "tasks are kept: continue with --resume and workers with more memory"
                ) from error
