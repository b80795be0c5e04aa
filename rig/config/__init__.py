"""Bench files: read and checked key by key; errors name the line."""

from rig.config.devices import ArmConfig, CameraConfig, TactileConfig
from rig.config.load import BENCHES, load_bench
from rig.config.models import BenchConfig

__all__ = [
    "BENCHES",
    "ArmConfig",
    "BenchConfig",
    "CameraConfig",
    "TactileConfig",
    "load_bench",
]
