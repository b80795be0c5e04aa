"""Scripted failures: what breaks, when, and for how long."""

from dataclasses import dataclass

from drivers.clock import NS_PER_S
from drivers.errors import unknown_name

OVERSHOOT_COUNTS = 30.0
"""How far a gripper with the fault `overshoot` moves beyond its target: about 19 mm of opening."""

KINDS = {
    "arm": ("protective_stop", "disconnect"),
    "gripper": ("fault", "disconnect", "blocked", "stuck", "false_success", "overshoot"),
    "tactile": ("freeze", "drop", "disconnect"),
    "camera": ("freeze", "drop", "disconnect"),
}
"""Kinds of fault by device.

Of a gripper: `blocked` fingers stop where they are and the gripper reports it; `stuck` ones stop, their
position is right but the gripper reports success; `false_success` also reports the requested position;
`overshoot` moves too far, in the direction of the motion.
"""


@dataclass(frozen=True, slots=True)
class ScriptedFault:
    """One failure of one device, `at_s` after the bench was made, lasting `duration_s`.

    device: arm, gripper, camera, tactile (all fingertips) or a sensor's serial. `lift` limits
    it to one lift ("t1/3": third lift of t1) and `attempt` to one attempt at it (0 is the
    first); None means any.
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
        """Whether this fault belongs to an attempt at a lift."""
        return self.lift in (None, lift) and self.attempt in (None, attempt)


@dataclass(frozen=True, slots=True)
class FaultScript:
    """The faults of one bench, asked by each fake as it works."""

    faults: tuple[ScriptedFault, ...] = ()

    def active(self, kind: str, time_ns: int, *names: str) -> bool:
        """Whether a fault of this kind is on at `time_ns` for a device with any of these names."""
        time_s = time_ns / NS_PER_S
        return any(
            fault.kind == kind
            and fault.device in names
            and fault.at_s <= time_s < fault.at_s + fault.duration_s
            for fault in self.faults
        )
