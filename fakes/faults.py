"""Scripted faults of simulated devices: their kind, start and duration."""

from dataclasses import dataclass

from drivers.clock import NS_PER_S
from drivers.errors import unknown_name

OVERSHOOT_COUNTS = 30.0
"""Counts that a gripper with the fault `overshoot` moves beyond its target: about 19 mm of opening."""

KINDS = {
    "arm": ("protective_stop", "disconnect"),
    "gripper": ("fault", "disconnect", "blocked", "stuck", "false_success", "overshoot"),
    "tactile": ("freeze", "drop", "disconnect"),
    "camera": ("freeze", "drop", "disconnect"),
}
"""Kinds of fault by device.

Of a gripper: with `blocked` the fingers stop where they are, and the gripper reports it. With `stuck` they
stop and the reported position is correct, but the gripper reports success. `false_success` also reports the
requested position. With `overshoot` the fingers move too far in the direction of the motion.
"""


@dataclass(frozen=True, slots=True)
class ScriptedFault:
    """One fault of one device, which begins `at_s` after the bench was made and lasts `duration_s`.

    device: arm, gripper, camera, tactile (all fingertips) or the serial of a sensor. kind: see `KINDS`. lift:
    the only lift with the fault ("t1/3": third lift of t1); None for all. attempt: the only attempt at a lift
    with the fault (0 is the first); None for all.
    """

    device: str
    kind: str
    at_s: float
    duration_s: float = 3600.0
    lift: str | None = None
    attempt: int | None = 0

    def __post_init__(self) -> None:
        known = KINDS.get(self.device, KINDS["tactile"])
        if self.kind not in known:
            raise unknown_name(f"fault of device '{self.device}'", self.kind, known)

    def concerns(self, lift: str, attempt: int) -> bool:
        """Whether this fault occurs in an attempt at a lift."""
        return self.lift in (None, lift) and self.attempt in (None, attempt)


@dataclass(frozen=True, slots=True)
class FaultScript:
    """The faults of one bench, which each simulated device checks."""

    faults: tuple[ScriptedFault, ...] = ()

    def active(self, kind: str, time_ns: int, *names: str) -> bool:
        """Whether a fault of this kind is active at `time_ns` for a device with any of these names."""
        time_s = time_ns / NS_PER_S
        return any(
            fault.kind == kind
            and fault.device in names
            and fault.at_s <= time_s < fault.at_s + fault.duration_s
            for fault in self.faults
        )
