"""Limit the BLAS threads while an estimator processes a frame.

The matrices are small, so several threads gain nothing: on two cores the 99th percentile of the time per
frame is 13 ms with them and 5.5 ms without. The command line limits the threads of its whole process. A
program that uses an estimator may need BLAS threads for other work, so for it they are limited only during a
frame.
"""

from contextlib import AbstractContextManager, nullcontext
from functools import cache

from threadpoolctl import ThreadpoolController


def one_blas_thread() -> AbstractContextManager[object]:
    """Return a context in which BLAS uses one thread; it does nothing if BLAS is already limited to one."""
    controller = _controller()
    if all(library.num_threads == 1 for library in controller.lib_controllers):
        return nullcontext()
    return controller.limit(limits=1)


@cache
def _controller() -> ThreadpoolController:
    """Return the controller of the loaded BLAS libraries; cached, because finding them takes some ms."""
    import scipy.linalg  # noqa: F401, loads the BLAS library of SciPy

    return ThreadpoolController().select(user_api="blas")
