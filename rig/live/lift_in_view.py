"""A lift in progress as viewers show it: the state after the messages received so far."""

from dataclasses import dataclass, field

from drivers.clock import NS_PER_S
from rig.live.feed import Message


@dataclass(slots=True)
class LiftInView:
    """State of a lift in progress; angles in degrees, None without an answer."""

    number: int
    title: str
    phase: str = ""
    estimate_deg: float | None = None
    truth_deg: float | None = None
    rates_hz: dict[str, float | None] = field(default_factory=dict)
    dropped: dict[str, int] = field(default_factory=dict)
    began_ns: int | None = None
    newest_ns: int = 0

    def take(self, message: Message) -> None:
        """Update the lift from a message."""
        values = message.values
        self.phase = values.get("phase", self.phase)
        if "time_ns" in values:
            self.began_ns = values["time_ns"] if self.began_ns is None else self.began_ns
            self.newest_ns = max(self.newest_ns, values["time_ns"])
        if message.kind == "figures":
            self.rates_hz, self.dropped = values["rates_hz"], values["dropped"]
            if values["estimate"]:
                self.estimate_deg = values["estimate"][-1][1]
            if values["truth"]:
                self.truth_deg = values["truth"][-1][1]

    @property
    def seen_s(self) -> float:
        """Time since the first message of the lift, s by the bench's clock."""
        return 0.0 if self.began_ns is None else (self.newest_ns - self.began_ns) / NS_PER_S

    def angles(self) -> str:
        """Return the lift's title, phase and angles as text."""
        return (
            f"{self.title}, phase {self.phase or '-'}: estimate {_degrees(self.estimate_deg)}, "
            f"markers {_degrees(self.truth_deg)}"
        )

    def frames(self) -> str:
        """Return frames per second by source, and the number of dropped frames, as text."""
        rates = ", ".join(
            f"{source} {'-' if rate is None else f'{rate:.0f}'}" for source, rate in self.rates_hz.items()
        )
        return f"frames/s {rates or '-'}; dropped {sum(self.dropped.values())}"


def _degrees(angle: float | None) -> str:
    return "-" if angle is None else f"{angle:+.1f} deg"
