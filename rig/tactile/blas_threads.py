"""Limits the threads of matrix products while an estimator works on a frame.

The matrices are small: threads gain nothing, and on two cores the slowest 1 % of the frames take 13 ms with
them, 5.5 without. The command line limits them for its whole process. A program that makes an estimator
itself may need its threads elsewhere, so there they are limited during a frame only.
"""

from contextlib import AbstractContextManager, nullcontext
from functools import cache

from threadpoolctl import ThreadpoolController


def one_blas_thread() -> AbstractContextManager[object]:
    """Return a context in which matrix products use one thread; it does nothing if they do so already."""
    controller = _controller()
    if all(library.num_threads == 1 for library in controller.lib_controllers):
        return nullcontext()
    return controller.limit(limits=1)


@cache
def _controller() -> ThreadpoolController:
    """Return the libraries of matrix products that are loaded now; finding them takes some ms."""
    import scipy.linalg  # noqa: F401, its library is loaded when it is first imported

    return ThreadpoolController().select(user_api="blas")
