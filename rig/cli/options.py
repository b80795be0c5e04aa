"""Options that several commands share, in groups that are frozen dataclasses (`rig.declared`)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.declared import option

if TYPE_CHECKING:
    from rig.config import BenchConfig
    from rig.sessions.about import Remarks

JsonOption = Annotated[bool, typer.Option("--json", help="Print only one JSON object on stdout.")]
TopicOption = Annotated[
    str | None,
    typer.Option("--topic", help="Image topic of a ROS bag. Default: its image topic, if there is only one."),
]
EngineOption = Annotated[
    str | None,
    typer.Option("--engine", help="Run on a dask cluster: dask://HOST:PORT. Default: this computer."),
]
SeedOption = Annotated[
    int, typer.Option("--seed", min=0, help="Seed of all random numbers, also of the simulation.")
]
BenchOption = Annotated[
    str, typer.Option("--bench", help="Bench: fake, hard or wire (simulated), or the path of a bench file.")
]
YesOption = Annotated[
    bool,
    typer.Option("--yes", help="Answer questions with yes, for scripts, unless they need a check by eye."),
]
ObjectsOption = Annotated[
    Path | None,
    typer.Option("--objects", help="Folder of your own objects. Default: objects/ beside the bench file."),
]
DryRunOption = Annotated[
    bool,
    typer.Option(
        "--dry-run",
        help="Read every device and show the plan, with the steps that would be refused. Nothing is moved or "
        "stored.",
    ),
]
ResumeOption = Annotated[
    bool,
    typer.Option(
        "--resume",
        help="Continue the session in --out with its stored options. Default: the newest unfinished one.",
    ),
]


@dataclass(frozen=True)
class BenchOptions:
    bench: BenchOption = "fake"
    own_objects: ObjectsOption = None
    seed: SeedOption = option(0, stored="seed")
    dry: DryRunOption = False
    yes: YesOption = False

    def config(self, command: str) -> "BenchConfig":
        """Return the bench with its calibrations and own objects.

        command: key of `rig.config.parts.NEEDS`. Raises `InputError`, also if a device that it needs is
        missing.
        """
        from rig.cli.common import say
        from rig.config.calibrations import load_calibrated_bench
        from rig.config.objects import with_objects
        from rig.config.parts import require_parts

        config = load_calibrated_bench(self.bench, say)
        require_parts(config, command)
        return with_objects(config, self.bench, self.own_objects)


@dataclass(frozen=True)
class SessionOptions:
    out: Path | None = option(None, "Session folder. Default: sessions/<date>_<kind>.")
    resume: ResumeOption = False
    name: str | None = option(None, "Name of the session, one line.")
    note: str | None = option(None, "Note to store with the session, one line.")
    tags: list[str] | None = option(None, "Tag of the session, for rig sessions; repeat for more.", "--tag")
    operator: str | None = option(None, "Name of the operator at the bench.")
    no_report: bool = option(False, "Do not write the report; rig report can write it later.")
    json: JsonOption = False

    def remarks(self) -> "Remarks":
        """Return the session's metadata. Raises `InputError`."""
        from rig.sessions.about import remarks_of

        return remarks_of(self.name, self.note, self.tags, self.operator)


@dataclass(frozen=True)
class WatchOptions:
    watch: bool = option(False, "Show the progress on a page that only this computer can reach.")
    watch_at: str | None = option(
        None,
        "As --watch, at HOST:PORT. With 0.0.0.0:8080 other computers can open the page, at the address with "
        "a key that the command prints.",
    )


@dataclass(frozen=True)
class RunOptions(WatchOptions, SessionOptions, BenchOptions):
    """Options of a trial or a recording. Those of the last base come first in the help."""
