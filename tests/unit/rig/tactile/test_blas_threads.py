"""Matrix products of an estimator that a program makes itself use one thread during a frame."""

import numpy as np
import pytest
from threadpoolctl import ThreadpoolController, threadpool_limits

from rig.tactile.blas_threads import one_blas_thread
from rig.tactile.contact.gate import ContactGate
from rig.tactile.slip.estimator import SlipEstimator
from support.drawn_sensor import drawn_press


def blas_threads() -> set[int]:
    """Return the numbers of threads of the loaded libraries."""
    found = ThreadpoolController().select(user_api="blas").info()
    return {library["num_threads"] for library in found}


def test_number_of_threads_is_restored() -> None:
    with threadpool_limits(2, user_api="blas"):
        before = blas_threads()
        with one_blas_thread():
            assert blas_threads() == {1}
        assert blas_threads() == before


def test_frame_is_estimated_with_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[set[int]] = []

    def find(gate: ContactGate, difference: np.ndarray) -> None:
        seen.append(blas_threads())

    monkeypatch.setattr(ContactGate, "find", find)
    with threadpool_limits(2, user_api="blas"):
        SlipEstimator(drawn_press(None)).update(drawn_press(None), 0)
    assert seen == [{1}]
