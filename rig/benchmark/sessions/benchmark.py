"""How long many sessions take to be listed, and a long one to be opened: as a person waits for it."""

import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.children import python_command
from rig.benchmark.measured import Measured, at_most
from rig.benchmark.sessions.made import make_session
from rig.config import load_bench
from rig.live.phases import begin_phase

LISTED_S, OPENED_S = 5.0, 2.0
OPEN = """
import sys
from pathlib import Path
from rig.sessions.manifest import read_manifest
from rig.sessions.rows import read_finished_lifts
folder = Path(sys.argv[1])
print(read_manifest(folder).kind, len(read_finished_lifts(folder)))
"""
"""What a program of one's own does to have a session's lifts."""


@dataclass(frozen=True, slots=True)
class Timed:
    """What was timed, each run of it in s, and what is asked of the quickest."""

    what: str
    runs_s: tuple[float, ...]
    limit: Measured


def run_sessions(
    folder: Path, sessions: int, lifts: int, long: int, runs: int, say: Callable[[str], None]
) -> list[Timed]:
    """Make the sessions that are not there yet below a folder, and time it. Raises `OSError`, `RigError`.

    runs: of each; the quickest counts, since whatever else the computer does only adds to it.
    """
    bench, many = load_bench("fake"), folder / "many"
    begin_phase(f"making {sessions} sessions")
    for number in range(sessions):
        if not (many / f"{number:04d}").exists():
            make_session(many / f"{number:04d}", bench, number, lifts)
    one = folder / "one" / f"{long}_lifts"
    if not one.exists():
        make_session(one, bench, 0, long)
    say(f"made {sessions} sessions of {lifts} lifts and one of {long}; timing {runs} runs of each ...")
    asked: list[tuple[str, Sequence[str], float]] = [
        (
            f"{sessions} sessions of {lifts} lifts listed",
            ("-m", "rig", "sessions", str(many), "--json"),
            LISTED_S,
        ),
        (f"one session of {long} lifts opened", ("-c", OPEN, str(one)), OPENED_S),
    ]
    found = []
    for what, arguments, limit_s in asked:
        runs_s = tuple(_time_s(arguments) for _ in range(runs))
        found.append(Timed(what, runs_s, at_most(f"{what}, s", min(runs_s), limit_s)))
    return found


def _time_s(arguments: Sequence[str]) -> float:
    """How long this Python takes for a program, from its start to its end. Raises as `subprocess.run`."""
    began = time.perf_counter()
    subprocess.run(python_command(*arguments), check=True, capture_output=True)  # noqa: S603 - this program
    return time.perf_counter() - began
