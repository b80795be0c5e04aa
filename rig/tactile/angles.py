"""An angle over time: of a fingertip, fused, or of the markers."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers import arguments
from drivers.clock import NS_PER_S
from drivers.errors import InputError
from drivers.formats import MAX_TIME_S
from drivers.values import short_repr
from rig.tactile.sample import SlipSample, State

if TYPE_CHECKING:
    from pandas import DataFrame  # pyright: ignore[reportMissingImports, reportMissingModuleSource]

Floats = NDArray[np.float64]
FUSED, MARKERS = "fused", "markers"
"""Sources of angles other than the fingertips' serials."""
LONGEST_GAP_NS = 50_000_000
"""Longest gap between frames over which an angle is interpolated (contract, metrics)."""
_MAX_NS = round(MAX_TIME_S * NS_PER_S)
MAX_DEG = 9e9
"""Largest angle that is accepted: millions of turns; larger ones are no angles."""


def _empty() -> Floats:
    return np.empty(0)


@dataclass(frozen=True, eq=False)
class Angles:
    """An angle over time.

    time_s: (N,) s, not decreasing. angle_deg: (N,) degrees, NaN if refused. sigma_deg: (N,) standard
    deviation, NaN if unknown; by default all are unknown. states: (N,) states of the estimator, or empty.
    contact_area_px: (N,) contact area of a fingertip, or empty. source: a fingertip's serial, `FUSED` or
    `MARKERS`; "" if unknown. zero_ns: the clock's time at `time_s` 0. Lists and other types that numpy can
    convert are accepted. Raises `InputError` for other shapes.
    """

    time_s: Floats
    angle_deg: Floats
    sigma_deg: Floats = field(default_factory=_empty)
    states: tuple[str, ...] = ()
    contact_area_px: Floats = field(default_factory=_empty)
    source: str = ""
    zero_ns: int = 0

    __repr__ = short_repr

    def __post_init__(self) -> None:
        time_s = arguments.array("Angles: time_s", self.time_s, (None,), MAX_TIME_S)
        angle_deg = arguments.array("Angles: angle_deg", self.angle_deg, (None,), MAX_DEG, unknown=True)
        sigma_deg = arguments.array("Angles: sigma_deg", self.sigma_deg, (None,), np.inf, unknown=True)
        sigma_deg = sigma_deg if sigma_deg.size else np.full(time_s.shape, np.nan)
        area_px = arguments.array(
            "Angles: contact_area_px", self.contact_area_px, (None,), np.inf, unknown=True
        )
        if not isinstance(self.states, tuple | list) or not all(isinstance(s, str) for s in self.states):
            raise arguments.refusal("Angles: states", self.states, "a tuple of texts")
        arguments.instance("Angles: source", self.source, str, "a text")
        zero_ns = arguments.whole("Angles: zero_ns", self.zero_ns, -_MAX_NS, _MAX_NS)
        arguments.array("Angles: time_s + zero_ns", time_s + zero_ns / NS_PER_S, (None,), MAX_TIME_S)
        optional = len(self.states), len(area_px)
        if not time_s.shape == angle_deg.shape == sigma_deg.shape or {*optional} - {0, len(time_s)}:
            raise InputError(
                f"Angles: {len(time_s)} times and {len(angle_deg)} angles: give the same number of each"
            )
        if (np.diff(time_s) < 0).any():
            raise InputError("Angles: time_s must not decrease: sort the rows by time")
        if (sigma_deg < 0).any():
            raise InputError("Angles: sigma_deg is negative: give a standard deviation, or NaN if unknown")
        object.__setattr__(self, "states", tuple(self.states))
        object.__setattr__(self, "zero_ns", zero_ns)
        for name, values in (
            ("time_s", time_s), ("angle_deg", angle_deg), ("sigma_deg", sigma_deg),
            ("contact_area_px", area_px),
        ):  # fmt: skip
            object.__setattr__(self, name, values.copy())  # the caller may change its arrays later

    @classmethod
    def of(cls, samples: Iterable[SlipSample], source: str = "", zero_ns: int = 0) -> "Angles":
        """Return samples as a series, in order of time. source, zero_ns: see the class."""
        arguments.instance("Angles.of: source", source, str, "a text")
        zero_ns = arguments.whole("Angles.of: zero_ns", zero_ns, -_MAX_NS, _MAX_NS)
        ordered = sorted(_check_samples(samples), key=lambda sample: sample.time_ns)
        areas = () if source in (FUSED, MARKERS) else [sample.contact_area_px for sample in ordered]
        return cls(
            (np.array([sample.time_ns for sample in ordered], np.int64) - zero_ns) / NS_PER_S,
            _column("angle_deg", [sample.angle_deg for sample in ordered]),
            _column("sigma_deg", [sample.sigma_deg for sample in ordered]),
            tuple(sample.state.value for sample in ordered),
            _column("contact_area_px", areas),
            source,
            zero_ns,
        )

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def time_ns(self) -> NDArray[np.int64]:
        """(N,) the times by the clock, ns."""
        return self.zero_ns + np.rint(self.time_s * NS_PER_S).astype(np.int64)

    @property
    def known(self) -> "Angles":
        """The samples with an angle."""
        return self.select(np.isfinite(self.angle_deg))

    def between(self, from_ns: int, until_ns: int) -> "Angles":
        """Return the samples from a time on, before another, ns by the clock."""
        from_ns = arguments.whole("Angles.between: from_ns", from_ns, -_MAX_NS, _MAX_NS)
        until_ns = arguments.whole("Angles.between: until_ns", until_ns, -_MAX_NS, _MAX_NS)
        time_ns = self.time_ns
        return self.select((time_ns >= from_ns) & (time_ns < until_ns))

    def select(self, which: NDArray[np.bool_]) -> "Angles":
        """Return some of the samples. which: (N,) bool. Raises `InputError` for other types and shapes."""
        which = arguments.mask("Angles.picked: which", which, len(self))
        states = tuple(s for s, k in zip(self.states, which, strict=True) if k) if self.states else ()
        areas = self.contact_area_px[which] if self.contact_area_px.size else self.contact_area_px
        return replace(
            self,
            time_s=self.time_s[which],
            angle_deg=self.angle_deg[which],
            sigma_deg=self.sigma_deg[which],
            states=states,
            contact_area_px=areas,
        )

    def at(self, time_s: ArrayLike) -> Floats:
        """Return the angle at other times, deg: interpolated over gaps of at most 50 ms, else NaN (contract).

        time_s: any shape, s, from the same zero as those of the samples. Raises `InputError` for other types
        and for values that are NaN or infinite.
        """
        seconds = arguments.array("Angles.at: time_s", time_s, None, MAX_TIME_S)
        known, at_ns = np.isfinite(self.angle_deg), np.rint(seconds * NS_PER_S).astype(np.int64)
        times, angles = np.rint(self.time_s[known] * NS_PER_S).astype(np.int64), self.angle_deg[known]
        if not times.size:
            return np.full(at_ns.shape, np.nan)
        after = np.searchsorted(times, at_ns)
        low, high = np.clip(after - 1, 0, None), np.clip(after, None, times.size - 1)
        gap_ns = times[high] - times[low]
        share = (at_ns - times[low]) / np.maximum(gap_ns, 1)
        near = (after > 0) & (after < times.size) & (gap_ns <= LONGEST_GAP_NS)
        found = np.where(near, angles[low] + (angles[high] - angles[low]) * share, np.nan)
        return np.where(times[high] == at_ns, angles[high], found)

    def at_ns(self, time_ns: int) -> float | None:
        """Return the angle at a time of the clock, as `at`; None instead of NaN."""
        time_ns = arguments.whole("Angles.at_ns: time_ns", time_ns, -_MAX_NS, _MAX_NS)
        angle = float(self.at((time_ns - self.zero_ns) / NS_PER_S))
        return None if np.isnan(angle) else angle

    def to_pandas(self) -> "DataFrame":
        """Return a pandas DataFrame with the columns time_s, angle_deg, sigma_deg and, if known, state."""
        columns: dict[str, Any] = {
            "time_s": self.time_s, "angle_deg": self.angle_deg, "sigma_deg": self.sigma_deg,
        }  # fmt: skip
        return data_frame(columns | ({"state": self.states} if self.states else {}))


def _check_samples(samples: Iterable[SlipSample]) -> list[SlipSample]:
    """Return samples as a list. Raises `InputError` unless each is a `SlipSample` with a time and a state."""
    name, expected = "Angles.of: samples", "samples of an estimator (rig.SlipSample)"
    try:
        iter(samples)
    except TypeError:
        raise arguments.refusal(name, samples, expected) from None
    found = [arguments.instance(name, sample, SlipSample, expected) for sample in samples]
    for sample in found:
        arguments.whole(f"{name}: time_ns", sample.time_ns, -_MAX_NS, _MAX_NS)
        arguments.instance(f"{name}: state", sample.state, State, "a state of rig.tactile.sample.State")
    return found


def _column(field: str, values: Sequence[float | None]) -> Floats:
    """Return a field of samples, (N,), NaN for None. Raises `InputError`."""
    numbers = [np.nan if value is None else value for value in values]
    return arguments.array(f"Angles.of: {field}", numbers, (None,), np.inf, unknown=True)


def data_frame(columns: Any) -> "DataFrame":
    """Return a pandas DataFrame. Raises `InputError` if pandas is not installed."""
    try:
        pandas = import_module("pandas")
    except ImportError as error:
        raise InputError("a DataFrame needs pandas, which is not installed: pip install pandas") from error
    return pandas.DataFrame(columns)
