"""Run foreign estimators: make them, validate their samples, and keep their errors from ending a lift.

A foreign estimator is a class that is not part of the rig and implements `TactileEstimator`. Its constructor
gets the frame without contact, (H, W, 3) uint8 RGB, and `aspect` and `sign` if it has parameters of these
names (see `EstimatorChoice.make`). It gets each frame once, in order, of the size of the background. If it
raises an exception or returns an invalid sample, the frame gets a sample `lost` with the fault.
"""

import inspect
import math
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from numbers import Real
from typing import Any

import numpy as np

from drivers.errors import EstimatorError, InputError, OperatorStopError
from drivers.named_classes import named_class, raised_text
from drivers.types import ArmState, Image
from rig.tactile.sample import FreshFrameEstimator, SlipSample, State, check_frame

GROUP = "slip_rig.estimators"
"""Group of the entry points in which installed packages offer estimators."""
STAGE = "update"
"""Name of the stage for the run time of an estimator that reports no stages."""
LONGEST_FAULT = 500
"""Length of the text of a fault, in characters; longer ones are cut."""


def require_estimator(name: str) -> None:
    """Import the class of that name. Raises `InputError` if there is none, or it is not an estimator."""
    require_update(name, named_class(name, "estimator", GROUP))


def require_update(name: str, kind: type[Any]) -> None:
    """Raise `EstimatorError` if a class has no method `update`."""
    if not callable(getattr(kind, "update", None)):
        raise EstimatorError(
            f"estimator '{name}': {kind.__name__} has no method update(image, time_ns): see docs/extending.md"
        )


class ForeignEstimator(FreshFrameEstimator):
    """Wraps a foreign estimator, validates its samples and catches its exceptions.

    The constructor raises `EstimatorError` if the estimator cannot be made with this background. `update`
    raises only `InputError`, for a frame of another shape.
    """

    stages = ()

    def __init__(
        self,
        name: str,
        background: Image,
        aspect: float | None,
        sign: int,
        kind: type[Any] | None = None,
    ) -> None:
        """Make the estimator. kind: its class; None to import the class by its name."""
        check_frame(background)
        super().__init__(background.shape)
        self._name, self._arm_fault = name, None
        found = kind or named_class(name, "estimator", GROUP)
        self._inner = _make(name, found, background, {"aspect": aspect, "sign": sign})

    def arm(self, state: ArmState) -> None:
        """Pass the state of the arm on, if the estimator has a method `arm`."""
        take = getattr(self._inner, "arm", None)
        if take is None:
            return
        try:
            with _no_warnings():
                take(state)
        except OperatorStopError:
            raise
        except Exception as error:
            self._arm_fault = self._arm_fault or f"arm() raised {raised_text(error)}"

    def _estimate(self, image: Image, time_ns: int) -> SlipSample:
        began = time.perf_counter()
        try:
            with _no_warnings():
                sample = self._inner.update(image.copy(), time_ns)
        except OperatorStopError:
            raise
        except Exception as error:
            return self._lost_sample(time_ns, f"update() raised {raised_text(error)}")
        spent = time.perf_counter() - began
        fault = self._arm_fault or _invalid_field(sample, image, time_ns)
        self._arm_fault = None
        if fault is not None:
            return self._lost_sample(time_ns, fault)
        return _plain(sample, sample.stage_s or {STAGE: spent})

    def _lost_sample(self, time_ns: int, fault: str) -> SlipSample:
        return SlipSample(time_ns, State.LOST, fault=f"{self._name}: {fault}"[:LONGEST_FAULT])


def _make(name: str, kind: type[Any], background: Image, more: dict[str, Any]) -> Any:
    require_update(name, kind)
    try:
        wanted = inspect.signature(kind).parameters
        with _no_warnings():
            return kind(background.copy(), **{key: more[key] for key in more if key in wanted})
    except (InputError, OperatorStopError):
        raise
    except Exception as error:
        raise EstimatorError(
            f"estimator '{name}': {kind.__name__}(background) raised {raised_text(error)}; "
            "see docs/extending.md"
        ) from error


@contextmanager
def _no_warnings() -> Iterator[None]:
    """Suppress warnings of NumPy about NaN and empty arrays; an invalid sample is reported as a fault."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def _invalid_field(sample: Any, image: Image, time_ns: int) -> str | None:
    """Return a message about the first invalid field of a sample; None if the sample is valid."""
    if not isinstance(sample, SlipSample):
        return f"update() returned a {type(sample).__name__}, not a SlipSample (in rig.tactile.sample)"
    if sample.time_ns != time_ns:
        return f"time_ns is {sample.time_ns!r} for a frame taken at {time_ns}"
    if not isinstance(sample.state, State):
        return f"state is {sample.state!r}, not a rig.tactile.sample.State"
    shift = (None, None) if sample.shift_px is None else sample.shift_px
    if not isinstance(shift, tuple) or len(shift) != 2:
        return f"shift_px is {shift!r}, not a pair of numbers"
    optional = {
        "angle_deg": sample.angle_deg, "sigma_deg": sample.sigma_deg, "rate_deg_s": sample.rate_deg_s,
        "shift_px[0]": shift[0], "shift_px[1]": shift[1],
    }  # fmt: skip
    needed = {"unseen_deg": sample.unseen_deg, "contact_area_px": sample.contact_area_px}
    for key, value in (optional | needed).items():
        if not _is_number(value) and (value is not None or key in needed):
            return f"{key} is {value!r}, not a finite number"
    for key, value in {"sigma_deg": sample.sigma_deg or 0.0, **needed}.items():
        if value < 0:
            return f"{key} is {value!r}, below 0"
    return _invalid_combination(sample, image)


def _invalid_combination(sample: SlipSample, image: Image) -> str | None:
    pixels = image.shape[0] * image.shape[1]
    if sample.contact_area_px > pixels:
        return f"contact_area_px is {sample.contact_area_px:g}, but the frame has {pixels} pixels"
    if sample.state is State.NO_CONTACT and (sample.angle_deg is not None or sample.contact_area_px > 0):
        return "state no_contact with an angle or a contact area"
    if not (sample.settled is None or isinstance(sample.settled, (bool, np.bool_))):
        return f"settled is {sample.settled!r}, not True, False or None"
    stages = sample.stage_s
    if not isinstance(stages, dict) or not all(_is_number(spent) for spent in stages.values()):
        return f"stage_s is {stages!r}, not a dict of seconds"
    if not isinstance(sample.skipped, tuple) or not all(isinstance(name, str) for name in sample.skipped):
        return f"skipped is {sample.skipped!r}, not a tuple of names"
    return None


def _plain(sample: SlipSample, stage_s: dict[str, float]) -> SlipSample:
    """Return the sample with Python floats in place of the numbers of other libraries."""
    return replace(
        sample,
        angle_deg=_plain_number(sample.angle_deg),
        sigma_deg=_plain_number(sample.sigma_deg),
        unseen_deg=float(sample.unseen_deg),
        rate_deg_s=_plain_number(sample.rate_deg_s),
        shift_px=sample.shift_px and (float(sample.shift_px[0]), float(sample.shift_px[1])),
        contact_area_px=float(sample.contact_area_px),
        settled=None if sample.settled is None else bool(sample.settled),
        stage_s={str(stage): float(spent) for stage, spent in stage_s.items()},
        fault=None,
    )


def _plain_number(value: float | None) -> float | None:
    return None if value is None else float(value)


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)
