"""The slip rig: the product over the neighbours `protocols`, `fakes` and `calibration`, and `drivers`.

For programs, `import rig` offers the names of `__all__`: sessions as arrays, estimators over frames, scores,
and calibrations solved from arrays. Each is imported when it is first asked for, so that `import rig` costs
nothing.

From the top: commands (`cli`), measured figures (`benchmark`), what programs use (`python`), pages and tools
that look at sessions (`report`, `export`, `training`, `doctor`, `calibrate`, `contract_checks`), experiments,
what is measured in a lift, results, the bench, sessions, configuration, perception. Imports point down only;
`pyproject.toml` holds it.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rig.python.angles import Angles
    from rig.python.calibrating import CameraSolution, HandEyeSolution, solve_camera, solve_hand_eye
    from rig.python.estimating import Score, estimate, score
    from rig.python.session import Lift, SensorFrame, Session, open_session

__all__ = [
    "Angles",
    "CameraSolution",
    "HandEyeSolution",
    "Lift",
    "Score",
    "SensorFrame",
    "Session",
    "estimate",
    "open_session",
    "score",
    "solve_camera",
    "solve_hand_eye",
]

_HOMES = {
    "angles": ("Angles",),
    "calibrating": ("CameraSolution", "HandEyeSolution", "solve_camera", "solve_hand_eye"),
    "estimating": ("Score", "estimate", "score"),
    "session": ("Lift", "SensorFrame", "Session", "open_session"),
}
"""Which module of `rig.python` each name is in."""


def __getattr__(name: str) -> Any:
    from importlib import import_module

    home = next((module for module, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(f"module 'rig' has no attribute '{name}'")
    value = getattr(import_module(f"rig.python.{home}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return list(__all__)
