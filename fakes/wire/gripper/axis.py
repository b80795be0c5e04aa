"""One motor of the simulated 3-Finger gripper, and the opening that two fingers make together."""

from dataclasses import dataclass

from fakes.world.motion import FingerPath
from fakes.world.trapezoid import TrapezoidProfile

ACCELERATION_COUNTS_S2 = 2000.0


@dataclass(slots=True)
class FingerMotor:
    """One motor: its path, what it was asked for, and the contact it stopped at (gDT's 1 or 2, or 0)."""

    path: FingerPath
    asked: tuple[int, int, int] = (0, 0, 0)
    contact: int = 0

    @classmethod
    def resting(cls, position: float) -> "FingerMotor":
        """An axis that has not moved yet."""
        return cls(FingerPath(position, position, TrapezoidProfile(0, 0.0, 1.0, 1.0)))

    def moving(self, now_ns: int) -> bool:
        """Whether it is on its way."""
        return not self.path.profile.done_at(now_ns)

    def go(self, end: float, speed: float, now_ns: int) -> None:
        """Start towards `end`, in counts and counts per second."""
        start = self.path.position_at(now_ns)
        self.path = FingerPath(
            start, end, TrapezoidProfile(now_ns, abs(end - start), speed, ACCELERATION_COUNTS_S2)
        )
        self.contact = 0

    def stop(self, now_ns: int) -> None:
        """Stay where it is."""
        self.path = self.path.cut_at(now_ns)

    @property
    def closing(self) -> bool:
        """The direction of its path."""
        return self.path.end > self.path.start


def mean_path(paths: list[FingerPath], now_ns: int) -> FingerPath:
    """One path for the opening between fingers, from now on.

    Exact while the fingers move alike; otherwise it ends where they end, at their mean speed.
    """
    moving = [path for path in paths if not path.profile.done_at(now_ns)]
    here = sum(path.position_at(now_ns) for path in paths) / len(paths)
    end = sum(path.end if path in moving else path.position_at(now_ns) for path in paths) / len(paths)
    if not moving:
        return FingerPath(here, here, TrapezoidProfile(0, 0.0, 1.0, 1.0))
    longest = max(moving, key=lambda path: path.profile.duration_s).profile
    if longest.start_ns == now_ns:
        return FingerPath(here, end, longest)
    speed = longest.speed * len(moving) / len(paths)
    return FingerPath(here, end, TrapezoidProfile(now_ns, abs(end - here), speed, ACCELERATION_COUNTS_S2))
