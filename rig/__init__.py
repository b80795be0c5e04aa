"""The slip rig: the product over the neighbours `protocols`, `fakes` and `calibration`, and `drivers`.

For programs, `import rig` offers the names of `__all__`: sessions as arrays, estimators over frames and over
live streams, scores, calibrations solved from arrays, and the errors that they raise. Each is imported when
it is first used, so that `import rig` costs nothing.

From the top: commands (`cli`), benchmarks (`benchmark`), the Python interface (`python`), tools (`training`,
`export`, `doctor`, `calibrate`, `contract_checks`), reports, experiments, the live view and labels, estimates
over frames, measurement of a lift, results and the bench, sessions, configuration, and at the bottom
perception (`tactile`), pages and the terminal. A package imports only packages below it, as the contracts in
`pyproject.toml` require.
"""

import importlib
import importlib.util
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.version import VERSION

if TYPE_CHECKING:
    from drivers.errors import (
        CalibrationError,
        DeviceError,
        EstimatorError,
        FormatError,
        InputError,
        OperatorStopError,
        RecordingError,
        RigError,
        SessionError,
    )
    from rig.frames.streaming import StreamingEstimator
    from rig.python.calibrating import CameraSolution, HandEyeSolution, solve_camera, solve_hand_eye
    from rig.python.estimating import Score, estimate, estimator, score
    from rig.python.session import (
        ArmTrack,
        GripperTrack,
        Lift,
        MarkerTrack,
        SensorFrame,
        Session,
        WrenchTrack,
        open_session,
    )
    from rig.tactile.angles import Angles
    from rig.tactile.sample import SlipSample

__version__ = VERSION

__all__ = [
    "Angles",
    "ArmTrack",
    "CalibrationError",
    "CameraSolution",
    "DeviceError",
    "EstimatorError",
    "FormatError",
    "GripperTrack",
    "HandEyeSolution",
    "HiddenPackageError",
    "InputError",
    "Lift",
    "MarkerTrack",
    "OperatorStopError",
    "RecordingError",
    "RigError",
    "Score",
    "SensorFrame",
    "Session",
    "SessionError",
    "SlipSample",
    "StreamingEstimator",
    "WrenchTrack",
    "estimate",
    "estimator",
    "open_session",
    "score",
    "solve_camera",
    "solve_hand_eye",
]

_HOMES = {
    "drivers.errors": (
        "CalibrationError", "DeviceError", "EstimatorError", "FormatError", "InputError", "OperatorStopError",
        "RecordingError", "RigError", "SessionError",
    ),
    "rig.frames.streaming": ("StreamingEstimator",),
    "rig.python.calibrating": ("CameraSolution", "HandEyeSolution", "solve_camera", "solve_hand_eye"),
    "rig.python.estimating": ("Score", "estimate", "estimator", "score"),
    "rig.python.session": (
        "ArmTrack", "GripperTrack", "Lift", "MarkerTrack", "SensorFrame", "Session", "WrenchTrack",
        "open_session",
    ),
    "rig.tactile.angles": ("Angles",),
    "rig.tactile.sample": ("SlipSample",),
}  # fmt: skip
"""Which module each name is in."""
_ROOT = Path(__file__).resolve().parents[1]
"""Folder that contains this package and the four packages below it."""


class HiddenPackageError(ImportError):
    """A module of another origin has the name of a package of the slip rig, and Python finds it first."""


def require_own_packages() -> None:
    """Raise `HiddenPackageError` if Python finds another `drivers`, `fakes`, `calibration` or `protocols`."""
    for name in ("drivers", "fakes", "calibration", "protocols"):
        loaded = sys.modules.get(name)
        spec = importlib.util.find_spec(name) if loaded is None else loaded.__spec__
        found = spec and (spec.origin or next(iter(spec.submodule_search_locations or ()), None))
        if found and Path(found).resolve().parent != _ROOT / name:
            place = Path(found).parent if Path(found).name == "__init__.py" else Path(found)
            raise HiddenPackageError(
                f"Python finds {place} before the package '{name}' of the slip rig ({_ROOT / name}). "
                f"Rename it, or move it into a package of your own, as my_lab/{place.name}. If it belongs to "
                "an installed package, install the slip rig into a separate environment",
                name=name,
                path=str(place),
            )


def __getattr__(name: str) -> Any:
    home = next((module for module, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module 'rig' has no attribute '{name}'")
    require_own_packages()  # again, because the program may have changed its search path since
    value = getattr(importlib.import_module(home), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)


if sys.argv[:1] != ["-m"]:  # with `python -m rig`, the current folder is removed from the path in `__main__`
    require_own_packages()
