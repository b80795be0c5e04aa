"""Keys that a bench of real hardware has to say: their defaults, the simulated cell's, would be obeyed."""

from collections.abc import Iterator

from rig.config.lines import KeyFault
from rig.config.models import ArmConfig, BenchConfig

ON_THE_FLANGE = {
    "tcp_m": "the tool centre point as measured, as [0.0, 0.0, 0.28]",
    "payload_kg": "the hand's mass as weighed, as 2.5",
    "payload_cog_m": "the hand's centre of mass from the flange, as [0.0, 0.0, 0.08]",
}
"""Keys of [arm] that are set on the controller, and what to write."""
LIMITS = {
    "workspace_min_m": "the lowest x, y, z of the tool, as [0.15, -0.35, 0.01]",
    "workspace_max_m": "the highest x, y, z of the tool, as [0.75, 0.35, 0.60]",
    "max_speed_m_s": "the highest speed of the tool, as 0.5",
    "max_acceleration_m_s2": "the highest acceleration of the tool, as 1.5",
    "max_payload_kg": "the heaviest payload, as 5.0",
    "max_contact_force_n": "by how much the force may change on the way down, as 20.0",
}
"""Keys of [arm.limits], and what to write. Joints have the arm's own range without a word."""


def required_limits(arm: ArmConfig) -> dict[str, str]:
    """Return the keys of [arm.limits] that a real arm has to have, and what to write."""
    if arm.force_sensor:
        return LIMITS
    return {key: write for key, write in LIMITS.items() if key != "max_contact_force_n"}


def missing_keys(config: BenchConfig) -> Iterator[KeyFault]:
    """Yield each key that is missing in a real bench's file, and what to write there.

    Only what was written counts: a session's stored copy, which holds every key, is not looked at here.
    """
    if config.simulated:
        return
    arm = config.arm
    for key, write in ON_THE_FLANGE.items():
        if key not in arm.model_fields_set:
            yield ("arm", key), f"is required of a real arm, on whose controller it is set: write {write}"
    if config.table.top_m is None:
        yield ("table", "top_m"), "is required of a real bench: write the height of the table's top, as 0.02"
    if "limits" not in arm.model_fields_set:
        yield (
            ("arm", "limits"),
            f"is required of a real arm: write [arm.limits] with {', '.join(required_limits(arm))}",
        )
        return
    for key, write in required_limits(arm).items():
        if key not in arm.limits.model_fields_set:
            yield ("arm", "limits", key), f"is required of a real arm: write {write}"
