"""Shared functions of trials and recordings: resuming with stored options, watch page, --dry-run."""

import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import typer

from drivers.errors import DeviceError, InputError, OperatorStopError, RecordingError, plural
from rig.cli.common import Exit, mark, print_result, say
from rig.cli.options import RunOptions, SessionOptions, WatchOptions
from rig.cli.report import report_after
from rig.declared import is_given
from rig.terminal.onlookers import observed_by, report_to
from rig.terminal.questions import ask
from rig.terminal.screen import begin_phase

if TYPE_CHECKING:
    from rig.bench.operators import ConsoleOperator
    from rig.bench.plan import Plan
    from rig.config import BenchConfig
    from rig.live.feed import Listener
    from rig.sessions.manifest import Manifest

Wanted = TypeVar("Wanted", bound="Manifest")


def bench_of(context: typer.Context, options: RunOptions, command: str) -> "BenchConfig":
    """Return the bench on the command line; for --resume with --out but without --bench the stored one.

    command: key of `rig.config.parts.NEEDS`. Raises `InputError` if a device that it needs is missing, and if
    the stored copy is contradictory, lacks a password, or has a class of the user's own: such a class runs
    code, so the operator must name the bench file on the command line.
    """
    from rig.config.load import require_consistent
    from rig.config.objects import with_objects
    from rig.config.parts import require_parts
    from rig.sessions.manifest import BenchManifest, is_session, read_manifest

    folder = options.out if options.resume and not is_given(context, "bench") else None
    manifest = None if folder is None or not is_session(folder) else read_manifest(folder)
    if folder is None or not isinstance(manifest, BenchManifest):
        return options.config(command)
    config, why = manifest.config, ""
    require_consistent(config, str(folder / "session.json"))
    if config.own_drivers:
        why = f"it names {', '.join(sorted(config.own_drivers))}, which runs only if you name the bench file"
    elif "***" in config.model_dump_json(include={"arm", "gripper", "tactile", "camera"}):
        why = "an address in it has a password, which is not stored"
    if why:
        raise InputError(
            f"{folder}: the stored bench '{config.name}' cannot be used: {why}: add --bench FILE"
        )
    say(f"{mark(config.simulated)}bench '{config.name}' as stored in {folder}")
    require_parts(config, command)
    return config if options.own_objects is None else with_objects(config, options.bench, options.own_objects)


def person_at(context: typer.Context, options: RunOptions, config: "BenchConfig") -> "ConsoleOperator":
    """Return the operator of a session. On a real bench --yes counts only if --bench names it."""
    from rig.bench.operators import ConsoleOperator

    agreed = options.yes and (config.simulated or is_given(context, "bench"))
    return ConsoleOperator(ask, agreed, feeder=config.feeder)


def session_to_continue(
    kind: type[Wanted], name: str, bench: str | None, session: SessionOptions, object_id: str | None = None
) -> tuple[Path, Wanted | None]:
    """Return the folder of a session, and the manifest of the session to resume there, or None.

    kind, name: kind of session, as `TrialManifest`, "trial". bench: name of the bench; None for kinds without
    bench. object_id: becomes part of the default folder's name. Without --out, --resume continues the newest
    unfinished session of that kind and bench. Raises `InputError` if there is none, or if the session in
    --out is of another kind.
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
    """Return the estimator of a resumed session: the one on the command line, else the stored one.

    Raises `EstimatorError` if a stored estimator is not the rig's own. Such a class runs code of its own, so
    the operator must name it on the command line; a session file is not enough.
    """
    from rig.tactile.estimators import stored_choice

    if estimator is None and stored is not None:
        stored_choice(stored, None).require_named()
    return estimator or stored


def lifts_done(folder: Path, wanted: int, jobs: int) -> tuple[int, float, float | None]:
    """Print and return the number of finished lifts of a trial that is resumed. Raises `SessionError`.

    Also returns the bench time of all attempts in s, and the mean time per finished lift in s, with `jobs`
    lifts in parallel; None without a lift.
    """
    from statistics import fmean

    from rig.sessions.rows import read_lifts, read_timing

    begun = _holds_results(folder)
    rows = read_lifts(folder) if begun else []
    done, earlier_s = sum(row.accepted for row in rows), sum((row.bench_s for row in rows), 0.0)
    say(f"continuing {folder}: {done} of {plural(wanted, 'lift')} done")
    times_s = [timing.wall_s for timing in read_timing(folder)] if begun else []
    return done, earlier_s, fmean(times_s) / jobs if times_s else None


@contextmanager
def may_be_continued(folder: Path, session: SessionOptions, partial: Callable[[], None]) -> Iterator[None]:
    """If a session ends early, print its results, write its report, and print the command to resume it.

    partial: function that prints the results on disk.
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


@contextmanager
def serve_watch_page(
    context: typer.Context, options: WatchOptions, title: str, what: str, total: int, done: int = 0
) -> "Iterator[tuple[Listener, ...]]":
    """Serve the page if an option asks for it; yield the listeners of lifts and poses.

    title, what, total, done: see `rig.live.state.Progress`. The page is served until the command ends; it
    then shows the report. Raises `InputError`.
    """
    if not options.watch and options.watch_at is None:
        yield ()
        return
    from rig.live.watch import WatchPage, watch_address

    page = WatchPage(watch_address(options.watch_at), title, what, done, total)
    context.call_on_close(page.close)
    context.call_on_close(report_to(page.show_report))
    with observed_by(page.show_event):
        say(f"watch page: {page.address}")
        yield (page.listener,)


def dry_run(config: "BenchConfig", plan: "Plan", json: bool) -> None:
    """Read every device of the bench; print the first findings of `rig doctor`, and the plan.

    Always raises `typer.Exit`: with 1 if a device cannot be used, else with 2 if a step of the plan would be
    refused, else with 0.
    """
    from rig.bench.findings import first_findings
    from rig.bench.source import reserve_bench, unconnected_bench
    from rig.doctor.finding import print_findings

    begin_phase("reading the devices")
    with reserve_bench(config), unconnected_bench(config) as bench:
        findings = first_findings(bench, config)
    figures = {
        "dry_run": True,
        "bench": config.name,
        "simulated": config.simulated,
        "findings": [asdict(finding) for finding in findings],
        "plan": list(plan.lines),
        "refused": list(plan.refused),
    }
    if not json:
        print_findings(findings)
    print_result(json, figures, plan.text())
    say("dry run: nothing was moved or stored")
    failed = any(finding.failed for finding in findings)
    raise typer.Exit(Exit.FAULT if failed else Exit.USAGE if plan.refused else Exit.DONE)
