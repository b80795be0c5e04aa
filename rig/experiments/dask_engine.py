"""Run tasks on an existing dask cluster, through joblib.

The cluster's workers need this product installed, and must see the sessions under the same paths.
"""

import socket
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

from drivers.errors import InputError
from rig.experiments.process_pool import run_tasks

Task = TypeVar("Task")
Result = TypeVar("Result")
SCHEME = "dask://"
CONNECT_TIMEOUT_S = 10
"""Time limit for connecting to the scheduler."""


def engine_address(engine: str) -> str:
    """Return the scheduler's address of `dask://HOST:PORT`. Raises `InputError` for anything else."""
    host, _, port = engine.removeprefix(SCHEME).rpartition(":")
    if not engine.startswith(SCHEME) or not host or not port.isdigit():
        raise InputError(f"--engine {engine}: give dask://HOST:PORT of a running dask scheduler")
    return f"tcp://{host}:{port}"


def runner(engine: str | None, jobs: int) -> Callable[[Callable[[Any], Any], list[Any]], Iterable[Any]]:
    """Return a function that executes tasks: in `jobs` processes of this computer, or on a cluster.

    Raises `InputError` for an invalid engine.
    """
    if engine is None:
        return lambda work, tasks: (result for _, result in run_tasks(work, tasks, jobs))
    engine_address(engine)
    return lambda work, tasks: run_on_cluster(engine, work, tasks)


def run_on_cluster(engine: str, work: Callable[[Task], Result], tasks: list[Task]) -> Iterator[Result]:
    """Yield the tasks' results as the cluster's workers finish, in any order.

    Raises `InputError` if the cluster does not answer or the libraries are missing.
    """
    joblib = _libraries()
    with _connected(engine_address(engine)), joblib.parallel_config(backend="dask"):
        run = joblib.Parallel(return_as="generator_unordered")
        yield from run(joblib.delayed(work)(task) for task in tasks)


@contextmanager
def _connected(address: str) -> Iterator[Any]:
    from distributed import Client

    try:
        _check_listening(address)
        client = Client(address, timeout=CONNECT_TIMEOUT_S, set_as_default=True)
    except (OSError, TimeoutError) as error:
        raise InputError(
            f"--engine: no dask scheduler answers at {address} ({error}); start one with `dask scheduler`"
        ) from error
    with client:
        if not client.scheduler_info()["workers"]:
            raise InputError(
                f"--engine: the cluster at {address} has no workers; start some with `dask worker`"
            )
        yield client


def _check_listening(address: str) -> None:
    """Raise immediately if the scheduler is not listening; dask would retry until its time-out."""
    host, _, port = address.removeprefix("tcp://").rpartition(":")
    socket.create_connection((host.strip("[]"), int(port)), CONNECT_TIMEOUT_S).close()


def _libraries() -> Any:
    try:
        import distributed  # noqa: F401 - joblib's dask backend needs it
        import joblib
    except ImportError as error:
        raise InputError(
            '--engine needs joblib and distributed: pip install "visuotactile-slip-rig[cluster]"'
        ) from error
    return joblib
