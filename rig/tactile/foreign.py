"""Estimators that are not the rig's own: made, held to what a sample may say, kept from ending a lift.

Such a class follows `TactileEstimator`. It is made with the frame without contact, (H, W, 3) uint8 RGB, and
with `aspect` and `sign` where its constructor has parameters of these names (see `EstimatorChoice.make`). It
sees each frame once, in order, of the background's size; whatever it raises or tells amiss becomes a sample
`lost` that says so.
"""

import inspect
import math
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any

from drivers.errors import EstimatorError, InputError, OperatorStopError, counted
from drivers.named_classes import named_class
from drivers.types import ArmState, Image
from rig.tactile.sample import FreshFrameEstimator, SlipSample, State, check_frame

GROUP = "slip_rig.estimators"
"""Entry points of this group offer estimators by name."""
STAGE = "update"
"""The stage under which an estimator's time is booked that books none itself."""
LONGEST_FAULT = 300


@dataclass(frozen=True, slots=True)
class EstimatorFaults:
    """How many frames an estimator failed on, and what was wrong with the first of them."""

    frames: int
    first: str

    def __str__(self) -> str:
        return (
            f"the estimator failed on {counted(self.frames, 'frame')}, counted as 'lost'; first: {self.first}"
        )


def faults_of(samples: Iterable[SlipSample]) -> EstimatorFaults | None:
    """Sum up where an estimator failed; None where it did not."""
    faults = [sample.fault for sample in samples if sample.fault is not None]
    return EstimatorFaults(len(faults), faults[0]) if faults else None


def together(faults: Sequence[EstimatorFaults]) -> EstimatorFaults:
    """Sum up what was summed up piece by piece; there has to be one."""
    return EstimatorFaults(sum(of.frames for of in faults), faults[0].first)


def require_estimator(name: str) -> None:
    """Import the class of that name. Raises `InputError` where there is none that could be an estimator."""
    require_update(name, named_class(name, "estimator", GROUP))


def require_update(name: str, kind: type[Any]) -> None:
    """Raise `EstimatorError` for a class that is no estimator."""
    if not callable(getattr(kind, "update", None)):
        raise EstimatorError(
            f"estimator '{name}': {kind.__name__} has no method update(image, time_ns): see docs/extending.md"
        )


class ForeignEstimator(FreshFrameEstimator):
    """An estimator of somebody's own, guarded.

    Raises `EstimatorError` where it cannot be made of this background, `InputError` for a frame of another
    shape, and nothing else.
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
        """Make it. kind: the class, where it is at hand; else it is imported by its name."""
        check_frame(background)
        super().__init__(background.shape)
        self._name, self._arm_fault = name, None
        found = kind or named_class(name, "estimator", GROUP)
        self._inner = _made(name, found, background, {"aspect": aspect, "sign": sign})

    def arm(self, state: ArmState) -> None:
        """Pass the arm's state on, where it wants to know."""
        take = getattr(self._inner, "arm", None)
        if take is None:
            return
        try:
            take(state)
        except OperatorStopError:
            raise
        except Exception as error:
            self._arm_fault = self._arm_fault or _text("arm() raised", error)

    def _estimate(self, image: Image, time_ns: int) -> SlipSample:
        began = time.perf_counter()
        try:
            sample = self._inner.update(image.copy(), time_ns)
        except OperatorStopError:
            raise
        except Exception as error:
            return self._lost(time_ns, _text("update() raised", error))
        spent = time.perf_counter() - began
        fault = self._arm_fault or _amiss(sample, image, time_ns)
        self._arm_fault = None
        if fault is not None:
            return self._lost(time_ns, fault)
        return _plain(sample, sample.stage_s or {STAGE: spent})

    def _lost(self, time_ns: int, fault: str) -> SlipSample:
        return SlipSample(time_ns, State.LOST, fault=f"{self._name}: {fault}"[:LONGEST_FAULT])


def _made(name: str, kind: type[Any], background: Image, more: dict[str, Any]) -> Any:
    require_update(name, kind)
    try:
        wanted = inspect.signature(kind).parameters
        return kind(background.copy(), **{key: more[key] for key in more if key in wanted})
    except (InputError, OperatorStopError):
        raise
    except Exception as error:
        raise EstimatorError(f"estimator '{name}': {_text('making it raised', error)}") from error


def _amiss(sample: Any, image: Image, time_ns: int) -> str | None:
    """Say what of an answer cannot be; None where all of it can."""
    if not isinstance(sample, SlipSample):
        return f"update() returned a {type(sample).__name__}, no SlipSample"
    if sample.time_ns != time_ns:
        return f"time_ns is {sample.time_ns!r} for a frame taken at {time_ns}"
    if not isinstance(sample.state, State):
        return f"state is {sample.state!r}, no rig.tactile.sample.State"
    shift = (None, None) if sample.shift_px is None else sample.shift_px
    if not isinstance(shift, tuple) or len(shift) != 2:
        return f"shift_px is {shift!r}, no pair of numbers"
    told = {
        "angle_deg": sample.angle_deg, "sigma_deg": sample.sigma_deg, "rate_deg_s": sample.rate_deg_s,
        "shift_px[0]": shift[0], "shift_px[1]": shift[1],
    }  # fmt: skip
    needed = {"unseen_deg": sample.unseen_deg, "contact_area_px": sample.contact_area_px}
    for key, value in (told | needed).items():
        if not _is_number(value) and (value is not None or key in needed):
            return f"{key} is {value!r}, no finite number"
    for key, value in {"sigma_deg": sample.sigma_deg or 0.0, **needed}.items():
        if value < 0:
            return f"{key} is {value!r}, below 0"
    return _impossible(sample, image)


def _impossible(sample: SlipSample, image: Image) -> str | None:
    pixels = image.shape[0] * image.shape[1]
    if sample.contact_area_px > pixels:
        return f"contact_area_px is {sample.contact_area_px:g}, the frame has {pixels} pixels"
    if sample.state is State.NO_CONTACT and (sample.angle_deg is not None or sample.contact_area_px > 0):
        return "state no_contact comes with an angle or a contact area"
    stages = sample.stage_s
    if not isinstance(stages, dict) or not all(_is_number(spent) for spent in stages.values()):
        return f"stage_s is {stages!r}, no dict of seconds"
    if not isinstance(sample.skipped, tuple) or not all(isinstance(name, str) for name in sample.skipped):
        return f"skipped is {sample.skipped!r}, no tuple of names"
    return None


def _plain(sample: SlipSample, stage_s: dict[str, float]) -> SlipSample:
    """The same with Python's own numbers, whatever library's they were."""
    return replace(
        sample,
        angle_deg=_plain_number(sample.angle_deg),
        sigma_deg=_plain_number(sample.sigma_deg),
        unseen_deg=float(sample.unseen_deg),
        rate_deg_s=_plain_number(sample.rate_deg_s),
        shift_px=sample.shift_px and (float(sample.shift_px[0]), float(sample.shift_px[1])),
        contact_area_px=float(sample.contact_area_px),
        stage_s={str(stage): float(spent) for stage, spent in stage_s.items()},
        fault=None,
    )


def _plain_number(value: float | None) -> float | None:
    return None if value is None else float(value)


def _is_number(value: object) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and math.isfinite(value)


def _text(what: str, error: Exception) -> str:
    return f"{what} {type(error).__name__}: {error}"
