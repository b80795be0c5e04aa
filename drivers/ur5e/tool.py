"""The tool on the flange as the controller has it: compared first, and overwritten only as agreed."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.errors import DeviceError
from drivers.types import Vector3, Vector6
from drivers.ur5e.link import ArmLink
from drivers.ur5e.setup import refusal, wait_for_arm

PAYLOAD_LIMIT_S = 0.5
SAME_TCP, SAME_KG, SAME_COG_M = 1e-4, 1e-3, 1e-3
"""How near two settings are the same: TCPs in m and rad."""


@dataclass(frozen=True, slots=True)
class Tool:
    """What hangs on the flange: TCP (x y z in m, rotation vector in rad), mass, centre of gravity."""

    flange_tcp: Vector6
    payload_kg: float
    payload_cog_m: Vector3


class ToolSetting:
    """The tool of a bench file, and whether the controller has it.

    The controller's own is set back to its installation's when a program starts, so it is compared each
    time; what was agreed to once is not asked again.
    """

    def __init__(self, tool: Tool, clock: Clock) -> None:
        self.tool, self._clock = tool, clock
        self._other: str | None = None
        self._agreed: set[str] = set()

    def compare(self, link: ArmLink) -> None:
        """Set the tool where the controller has the same, or where overwriting this one was agreed to."""
        self._other = other_tool(link, self.tool)
        if self._other is None or self._other in self._agreed:
            self._set(link)

    def agree(self, link: ArmLink, confirm: Callable[[str], None]) -> None:
        """Ask before another tool on the controller is overwritten; `confirm` raises unless agreed."""
        if self._other is not None:
            confirm(
                f"The arm's controller has {self._other} in the bench file. Is the bench file right, and "
                "shall it be set? (With the same in the installation on the pendant nobody is asked.)"
            )
            self._agreed.add(self._other)
            self._set(link)

    def require(self) -> None:
        """Raise `DeviceError` while the controller has another tool."""
        if self._other is not None:
            raise DeviceError(
                f"arm: the controller has {self._other} in the bench file, and nobody agreed to "
                "overwrite it; put the same into both"
            )

    def _set(self, link: ArmLink) -> None:
        set_tool(link, self.tool, self._clock)
        self._other = None


def other_tool(link: ArmLink, tool: Tool) -> str | None:
    """Say what the controller has for a tool where it is not `tool`; None where it is, as far as it tells."""
    there, sample = link.control.tcp(), link.sample()
    differs = []
    if _apart(there, tool.flange_tcp) > SAME_TCP:
        differs.append(f"TCP {_numbers(there)} instead of {_numbers(tool.flange_tcp)} (m, rad)")
    if abs(sample.payload_kg - tool.payload_kg) > SAME_KG:  # never so where the controller does not tell
        differs.append(f"payload {sample.payload_kg:.3f} kg instead of {tool.payload_kg:.3f} kg")
    if _apart(sample.payload_cog_m, tool.payload_cog_m) > SAME_COG_M:
        cog, told = _numbers(sample.payload_cog_m), _numbers(tool.payload_cog_m)
        differs.append(f"centre of gravity {cog} m instead of {told} m")
    return ", ".join(differs) or None


def set_tool(link: ArmLink, tool: Tool, clock: Clock) -> None:
    """Set TCP and payload, and see that the controller has them. Raises `DeviceError`."""
    taken, there = link.control.set_tcp(tool.flange_tcp)
    if not taken:
        raise refusal(link, "setTcp", clock)
    if _apart(there, tool.flange_tcp) > SAME_TCP:
        raise DeviceError(f"arm: the controller's TCP is {there} although {tool.flange_tcp} was set")
    if not link.control.set_payload(tool.payload_kg, tool.payload_cog_m):
        raise refusal(link, "setPayload", clock)
    if not math.isnan(link.sample().payload_kg):

        def weighed() -> bool:
            return abs(link.sample().payload_kg - tool.payload_kg) <= SAME_KG

        wait_for_arm(weighed, PAYLOAD_LIMIT_S, f"take the payload of {tool.payload_kg} kg", clock)


def _apart(there: Sequence[float], here: Sequence[float]) -> float:
    return max(abs(a - b) for a, b in zip(there, here, strict=True))


def _numbers(values: Sequence[float]) -> str:
    return "(" + ", ".join(f"{value:.4g}" for value in values) + ")"
