"""Options that commands share, each group a frozen dataclass (`rig.cli.declared`)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.declared import option

if TYPE_CHECKING:
    from rig.config import BenchConfig
    from rig.sessions.remarks import Remarks

JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else there.")
]
TopicOption = Annotated[
    str | None,
    typer.Option(
        "--topic", help="Of a ROS bag: the topic of the images. Default: the only topic of images in it."
    ),
]
SeedOption = Annotated[int, typer.Option("--seed", min=0, help="Seed of everything simulated or drawn.")]
BenchOption = Annotated[str, typer.Option("--bench", help="fake, hard, wire, or the path of a bench file.")]
YesOption = Annotated[bool, typer.Option("--yes", help="Agree to every question (for scripts).")]
ObjectsOption = Annotated[
    Path | None,
    typer.Option("--objects", help="Folder of your own objects; default: objects/ beside the bench file."),
]
DryRunOption = Annotated[
    bool,
    typer.Option(
        "--dry-run",
        help="Read every device, show the whole plan and what of it would be refused; move and keep nothing.",
    ),
]
ResumeOption = Annotated[
    bool,
    typer.Option(
        "--resume",
        help="Continue the session in --out, or the newest unfinished one on this bench, with its options.",
    ),
]


@dataclass(frozen=True, slots=True)
class BenchOptions:
    """The bench, its objects, and consent to move it."""

    bench: BenchOption = "fake"
    own_objects: ObjectsOption = None
    seed: SeedOption = option(0, stored="seed")
    dry: DryRunOption = False
    yes: YesOption = False

    def config(self, command: str) -> "BenchConfig":
        """Return the bench with its calibrations and own objects.

        command: as in `rig.config.parts.NEEDS`. Raises `InputError`, also if the bench lacks what it needs.
        """
        from rig.cli.common import say
        from rig.config.calibrations import load_calibrated_bench
        from rig.config.objects import with_objects
        from rig.config.parts import require_parts

        config = load_calibrated_bench(self.bench, say)
        require_parts(config, command)
        return with_objects(config, self.bench, self.own_objects)


@dataclass(frozen=True, slots=True)
class SessionOptions:
    """The folder of a session, its metadata, and its report."""

    out: Path | None = option(None, "Session folder; default sessions/<date>_<what>.")
    resume: ResumeOption = False
    name: str | None = option(None, "What the session is called, in one line.")
    note: str | None = option(None, "A line kept with the session.")
    tags: list[str] | None = option(None, "A word to find the session by; repeat for more.", "--tag")
    operator: str | None = option(None, "Who stands at the bench.")
    no_report: bool = option(False, "Leave the report out: rig report makes it later.")
    json: JsonOption = False

    def remarks(self) -> "Remarks":
        """Return the session's metadata. Raises `InputError`."""
        from rig.sessions.remarks import remarks_of

        return remarks_of(self.name, self.note, self.tags, self.operator)


@dataclass(frozen=True, slots=True)
class WatchOptions:
    """The page in the browser, and notifications."""

    watch: bool = option(False, "Show it on a page in the browser, on this computer.")
    watch_at: str | None = option(None, "The same at HOST:PORT; 0.0.0.0:8080 lets other computers look on.")
    notify: str | None = option(
        None, "Command to run as COMMAND EVENT TEXT on each fault, question and the end."
    )
