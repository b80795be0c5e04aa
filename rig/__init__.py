"""The slip rig: the product over the neighbours `protocols`, `fakes` and `calibration`, and `drivers`.

For programs, `import rig` offers the names of `__all__`: sessions as arrays, estimators over frames and over
live streams, scores, and calibrations solved from arrays. Each is imported when it is first used, so that
`import rig` costs nothing.

From the top: commands (`cli`), measured figures (`benchmark`), what programs use (`python`), pages and tools
that look at sessions (`report`, `export`, `training`, `doctor`, `calibrate`, `contract_checks`), experiments,
what is measured in a lift, results, the bench, sessions, configuration, perception. Imports point down only;
`pyproject.toml` holds it.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rig.frames.streaming import AngleSample, StreamingEstimator
    from rig.python.calibrating import CameraSolution, HandEyeSolution, solve_camera, solve_hand_eye
    from rig.python.estimating import Score, estimate, estimator, score
    from rig.python.session import Lift, SensorFrame, Session, open_session
    from rig.python.tracks import Angles, ArmTrack, GripperTrack, MarkerTrack, WrenchTrack

__all__ = [
    "AngleSample",
    "Angles",
    "ArmTrack",
    "CameraSolution",
    "GripperTrack",
    "HandEyeSolution",
    "Lift",
    "MarkerTrack",
    "Score",
    "SensorFrame",
    "Session",
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
    "frames.streaming": ("AngleSample", "StreamingEstimator"),
    "python.calibrating": ("CameraSolution", "HandEyeSolution", "solve_camera", "solve_hand_eye"),
    "python.estimating": ("Score", "estimate", "estimator", "score"),
    "python.session": ("Lift", "SensorFrame", "Session", "open_session"),
    "python.tracks": ("Angles", "ArmTrack", "GripperTrack", "MarkerTrack", "WrenchTrack"),
}
"""Which module of `rig` each name is in."""


def __getattr__(name: str) -> Any:
    from importlib import import_module

    home = next((module for module, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module 'rig' has no attribute '{name}'")
    value = getattr(import_module(f"rig.{home}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)
