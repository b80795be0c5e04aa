"""Matrix products of an estimator that a program makes itself use one thread during a frame."""

from types import SimpleNamespace

import numpy as np
import pytest
from threadpoolctl import ThreadpoolController, threadpool_limits

from rig.tactile.blas_threads import one_blas_thread
from rig.tactile.slip import estimator
from rig.tactile.slip.estimator import SlipEstimator
from rig.tactile.slip.gradient import learn_map
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


@pytest.mark.parametrize("calibrated", [False, True])
def test_slopes_are_computed_with_one_thread(monkeypatch: pytest.MonkeyPatch, calibrated: bool) -> None:
    seen: list[set[int]] = []

    def compute(difference: np.ndarray, mask: np.ndarray) -> object:
        seen.append(blas_threads())
        return difference if calibrated else learn_map(difference, mask)

    press = drawn_press(20.0, (80.0, 25.0))
    tracker = SlipEstimator(drawn_press(None))
    if calibrated:
        monkeypatch.setattr(tracker, "_slopes", SimpleNamespace(of=compute))
    else:
        monkeypatch.setattr(estimator, "learn_map", compute)
    with threadpool_limits(2, user_api="blas"):
        for frame in range(2):
            tracker.update(press, frame * 20_000_000)
            press = np.roll(press, 1, axis=0)
    assert seen
    assert all(threads == {1} for threads in seen)
