"""Arrays of an angle over time."""

from dataclasses import dataclass, field
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from drivers.errors import InputError
from drivers.values import short_repr

if TYPE_CHECKING:
    from pandas import DataFrame  # pyright: ignore[reportMissingImports, reportMissingModuleSource]

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Angles:
    """An angle over time.

    time_s: (N,) s, not decreasing. angle_deg: (N,) degrees, NaN if refused. sigma_deg: (N,) standard
    deviation, NaN if unknown; by default all are unknown. states: (N,) states of the estimator, or empty.
    Lists and other types that numpy can convert are accepted. Raises `InputError` for other shapes.
    """

    time_s: Floats
    angle_deg: Floats
    sigma_deg: Floats = field(default_factory=lambda: np.empty(0))
    states: tuple[str, ...] = ()

    __repr__ = short_repr

    def __post_init__(self) -> None:
        time_s, angle_deg = _row("time_s", self.time_s), _row("angle_deg", self.angle_deg)
        sigma_deg = _row("sigma_deg", self.sigma_deg)
        sigma_deg = sigma_deg if sigma_deg.size else np.full(time_s.shape, np.nan)
        if not time_s.shape == angle_deg.shape == sigma_deg.shape or len(self.states) not in (0, len(time_s)):
            raise InputError(
                f"Angles: {len(time_s)} times and {len(angle_deg)} angles: give the same number of each"
            )
        if not np.isfinite(time_s).all() or (np.diff(time_s) < 0).any():
            raise InputError("Angles: time_s must be finite and not decrease: sort the rows by time")
        for name, values in (("time_s", time_s), ("angle_deg", angle_deg), ("sigma_deg", sigma_deg)):
            object.__setattr__(self, name, values)

    def __len__(self) -> int:
        return len(self.time_s)

    def to_pandas(self) -> "DataFrame":
        """Return a pandas DataFrame with the columns time_s, angle_deg, sigma_deg and, if known, state."""
        columns: dict[str, Any] = {
            "time_s": self.time_s, "angle_deg": self.angle_deg, "sigma_deg": self.sigma_deg,
        }  # fmt: skip
        return data_frame(columns | ({"state": self.states} if self.states else {}))


def data_frame(columns: Any) -> "DataFrame":
    """Return a pandas DataFrame. Raises `InputError` if pandas is not installed."""
    try:
        pandas = import_module("pandas")
    except ImportError as error:
        raise InputError("a DataFrame needs pandas, which is not installed: pip install pandas") from error
    return pandas.DataFrame(columns)


def _row(name: str, values: ArrayLike) -> Floats:
    try:
        row = np.asarray(values, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"Angles: {name} are not numbers: {error}") from error
    if row.ndim != 1:
        raise InputError(f"Angles: {name} has shape {row.shape}: give (N,)")
    return row
