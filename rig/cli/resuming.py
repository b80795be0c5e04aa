"""Resumption of a session with its stored options; the command for it is printed if a session ends early."""

import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from drivers.errors import DeviceError, OperatorStopError, RecordingError, counted
from rig.cli.common import say
from rig.cli.options import SessionOptions
from rig.cli.report import report_after

if TYPE_CHECKING:
    from rig.sessions.manifest import Manifest

Wanted = TypeVar("Wanted", bound="Manifest")


def continued(
    kind: type[Wanted], name: str, bench: str | None, session: SessionOptions, object_id: str | None = None
) -> tuple[Path, Wanted | None]:
    """Return where a session goes, and the manifest of one that is continued there.

    kind, name: of the session, as `TrialManifest`, "trial". bench: its name, None for kinds without.
    Without --out, --resume continues the newest unfinished session of that kind and bench. Raises
    `InputError` where there is none, and for a session of another kind.
    """
    from rig.sessions.manifest import is_session, read_manifest_of
    from rig.sessions.session import default_folder, newest_unfinished

    if not session.resume:
        return session.out or default_folder(name, object_id), None
    folder = session.out or newest_unfinished(name, bench)
    if not is_session(folder):
        return folder, None
    stored = read_manifest_of(folder, kind, f"--resume continues a '{name}' session here")
    return folder, stored


def named_again(estimator: str | None, stored: str | None) -> str | None:
    """Return the estimator to go on with, the stored one by default.

    Raises `EstimatorError` where that one is not the rig's own: it runs where a person names it, and a
    session's file is no person.
    """
    from rig.tactile.estimators import stored_choice

    if estimator is None and stored is not None:
        stored_choice(stored, None).require_named()
    return estimator or stored


def say_done(folder: Path, wanted: int) -> int:
    """Say and return how many of the lifts of a trial that goes on are done. Raises `SessionError`."""
    from rig.sessions.rows import read_lifts

    done = sum(row.accepted for row in read_lifts(folder)) if _holds_results(folder) else 0
    say(f"continuing {folder}: {done} of {counted(wanted, 'lift')} done")
    return done


def usual_lift_s(folder: Path, jobs: int) -> float | None:
    """Return the mean time per lift so far, s, with `jobs` lifts side by side; None without a lift."""
    from statistics import fmean

    from rig.report.session import read_timing

    times_s = [timing.wall_s for timing in read_timing(folder)] if _holds_results(folder) else []
    return fmean(times_s) / jobs if times_s else None


@contextmanager
def may_be_continued(folder: Path, session: SessionOptions, partial: Callable[[], None]) -> Iterator[None]:
    """If a session ends early, print and report what it holds, and print the command that continues it.

    partial: prints the results that are on disk.
    """
    try:
        yield
    except (OperatorStopError, DeviceError, RecordingError):
        if _holds_results(folder):
            partial()
            report_after(folder, session.no_report)
        if (folder / "session.json").is_file():
            more = [] if session.resume else ["--resume"]
            more += [] if session.out else ["--out", str(folder)]
            say(f"continue with: {shlex.join(['rig', *sys.argv[1:], *more])}")
        raise


def _holds_results(folder: Path) -> bool:
    from rig.sessions.files import RESULTS

    return any((folder / name).is_file() for name in RESULTS.values())
