"""Bench files: read, checked key by key, refused with the line that is wrong.

Imports calibration files and the vocabulary of `drivers`; it knows no device.
"""

from rig.config.load import BENCHES, load_bench, validation_text
from rig.config.models import (
    ArmConfig,
    BenchConfig,
    CameraConfig,
    FakesConfig,
    FaultConfig,
    GripperConfig,
    TactileConfig,
)

__all__ = [
    "BENCHES",
    "ArmConfig",
    "BenchConfig",
    "CameraConfig",
    "FakesConfig",
    "FaultConfig",
    "GripperConfig",
    "TactileConfig",
    "load_bench",
    "validation_text",
]
