"""Options that commands share, each group a frozen dataclass (`rig.cli.declared`)."""

from dataclasses import dataclass
from typing import Annotated

import typer

from rig.cli.common import (
    BenchOption,
    JsonOption,
    NameOption,
    NoteOption,
    ObjectsOption,
    OperatorOption,
    OutOption,
    ResumeStoredOption,
    SeedOption,
    TagOption,
    YesOption,
)
from rig.cli.declared import stored_as

DryRunOption = Annotated[
    bool,
    typer.Option(
        "--dry-run",
        help="Read every device, show the whole plan and what of it would be refused; move and keep nothing.",
    ),
]
WatchOption = Annotated[
    bool, typer.Option("--watch", help="Show it on a page in the browser, on this computer.")
]
WatchAtOption = Annotated[
    str | None,
    typer.Option("--watch-at", help="The same at HOST:PORT; 0.0.0.0:8080 lets other computers look on."),
]
NotifyOption = Annotated[
    str | None,
    typer.Option(
        "--notify", help="Command to run as COMMAND EVENT TEXT on each fault, question and the end."
    ),
]


@dataclass(frozen=True, slots=True)
class BenchOptions:
    """The bench, its objects, and consent to move it."""

    bench: BenchOption = "fake"
    own_objects: ObjectsOption = None
    seed: SeedOption = stored_as("seed", 0)
    dry: DryRunOption = False
    yes: YesOption = False


@dataclass(frozen=True, slots=True)
class SessionOptions:
    """The folder of a session, its metadata, and its report."""

    out: OutOption = None
    resume: ResumeStoredOption = False
    name: NameOption = None
    note: NoteOption = None
    tags: TagOption = None
    operator: OperatorOption = None
    no_report: Annotated[
        bool, typer.Option("--no-report", help="Leave the report out: rig report makes it later.")
    ] = False
    json: JsonOption = False


@dataclass(frozen=True, slots=True)
class WatchOptions:
    """The page in the browser, and notifications."""

    watch: WatchOption = False
    watch_at: WatchAtOption = None
    notify: NotifyOption = None
