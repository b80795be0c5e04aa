"""When the phases of a recorded lift began, by name, checked for their order."""

from pathlib import Path

from drivers.clock import to_ns
from drivers.errors import SessionError
from protocols.observer import REQUIRED
from rig.sessions.layout import is_unfinished
from rig.sessions.recording_file import Gaps

_LONGEST_S = 3600.0
"""No lift takes longer."""


class PhaseTimes:
    """Collects the phases of a recording.

    The phases that every whole lift has come in their order; phases of other versions may stand between them.
    gaps: of the recording, if they are passed over; a phase that one hides may then be missing.
    """

    def __init__(self, path: Path, gaps: Gaps | None = None) -> None:
        self._path = path
        self._gaps = gaps
        self._times_ns: dict[str, int] = {}

    def add(self, name: str, time_ns: int) -> None:
        """Add a phase. Raises `SessionError` if it does not follow those so far."""
        begun = list(self._times_ns.values()) or [time_ns]
        in_time = begun[-1] <= time_ns <= begun[0] + to_ns(_LONGEST_S)
        if name in self._times_ns or not in_time or not self._follows(name):
            raise SessionError(f"{self._path}: the recording is damaged (phase {name} out of its order)")
        self._times_ns[name] = time_ns

    def complete(self) -> dict[str, int]:
        """Return all phases, ns. Raises `SessionError` if one is missing from a finished recording."""
        missing = [phase.value for phase in REQUIRED if phase not in self._times_ns]
        if missing and not is_unfinished(self._path):
            raise SessionError(f"{self._path}: is no whole lift: phase {', '.join(missing)} is missing")
        return self._times_ns

    def _follows(self, name: str) -> bool:
        if name not in REQUIRED:
            return True
        left = REQUIRED[sum(other in REQUIRED for other in self._times_ns) :]
        if self._gaps:
            return name in left
        return [name] == list(left[:1])
