"""Bench files: read and checked key by key; errors name the line."""

from rig.config.load import BENCHES, load_bench, validation_text
from rig.config.models import (
    ArmConfig,
    BenchConfig,
    CameraConfig,
    TactileConfig,
)

__all__ = [
    "BENCHES",
    "ArmConfig",
    "BenchConfig",
    "CameraConfig",
    "TactileConfig",
    "load_bench",
    "validation_text",
]
