"""What a person has clicked on a clip's frames: on disk after every click, so that none is ever lost."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from drivers.errors import InputError
from drivers.formats import read_bounded
from rig.labels.angle_clip import ClipToLabel, FrameChoice
from rig.labels.angle_lines import PASSES, SHORTEST_PX, Line
from rig.sessions.codec import STRICT, Codec, json_line
from rig.sessions.files import write_file

LINES = "label_lines.json"
SCHEMA = 1
MOST_CLICKS = 100_000
MOST_BYTES = 20_000_000


@dataclass(frozen=True, slots=True)
class Click:
    """One end of a line. drawn_in: the pass, 0 or 1. x, y: px of the frame; a pixel's middle is whole."""

    __pydantic_config__ = STRICT
    drawn_in: int
    frame: int
    x: float
    y: float


@dataclass(frozen=True, slots=True)
class DrawnLines:
    """The content of `label_lines.json`. clicks: in the order in which they were made."""

    __pydantic_config__ = STRICT
    schema: int
    size_px: tuple[int, int]
    choice: FrameChoice
    clicks: tuple[Click, ...]


_FILE = Codec[DrawnLines](DrawnLines)


def read_drawn(path: Path) -> DrawnLines | None:
    """Read what was drawn before; None without a file. Raises `InputError` for one that is no such file."""
    if not path.exists():
        return None
    try:
        drawn = _FILE.parsed(read_bounded(path, MOST_BYTES))
    except ValueError as error:
        raise InputError(f"{path}: {error}: move the file away to begin anew") from error
    if drawn.schema != SCHEMA:
        raise InputError(f"{path}: its schema is {drawn.schema}, this version reads {SCHEMA}: update the rig")
    if drawn.choice.reference not in drawn.choice.frames:
        raise InputError(f"{path}: the reference is none of its frames: move the file away to begin anew")
    return drawn


def ends_in(clicks: Sequence[Click], drawn_in: int) -> dict[int, list[tuple[float, float]]]:
    """Return the ends of the newest line of each frame in one pass: two, or one where it is only begun."""
    ends: dict[int, list[tuple[float, float]]] = {}
    for click in clicks:
        if click.drawn_in == drawn_in:
            before = ends.get(click.frame, [])
            ends[click.frame] = [*(before if len(before) == 1 else []), (click.x, click.y)]
    return ends


class LineLog:
    """The clicks on one clip, each written to `file` before it counts.

    drawn: what `file` held before. Raises `InputError` where that is of other frames.
    """

    def __init__(self, file: Path, clip: ClipToLabel, drawn: DrawnLines | None = None) -> None:
        if drawn is not None and drawn.size_px != clip.size_px:
            raise InputError(f"{file}: is of frames of another size: move it away to begin anew")
        self.file, self._clip = file, clip
        self._clicks = () if drawn is None else drawn.clicks
        for click in self._clicks:
            self._check(click)

    @property
    def clicks(self) -> tuple[Click, ...]:
        """All clicks so far, in order."""
        return self._clicks

    def add(self, click: Click) -> None:
        """Take the next click. Raises `InputError` for one that cannot be, `RecordingError` if not kept."""
        self._check(click)
        begun = ends_in(self._clicks, click.drawn_in).get(click.frame, [])
        if len(begun) == 1 and math.dist(begun[0], (click.x, click.y)) < SHORTEST_PX:
            raise InputError(f"less than {SHORTEST_PX:g} px from the first end: click farther away")
        self._keep((*self._clicks, click))

    def undo(self) -> Click | None:
        """Take the last click back and return it; None where there is none."""
        last = self._clicks[-1] if self._clicks else None
        self._keep(self._clicks[:-1])
        return last

    def passes(self) -> list[dict[int, Line]]:
        """Return the finished lines of both passes by frame."""
        both = [ends_in(self._clicks, drawn_in) for drawn_in in range(PASSES)]
        return [{n: (*ends[0], *ends[1]) for n, ends in one.items() if len(ends) == 2} for one in both]

    def _keep(self, clicks: tuple[Click, ...]) -> None:
        drawn = DrawnLines(SCHEMA, self._clip.size_px, self._clip.choice, clicks)
        write_file(self.file, json_line(drawn))
        self._clicks = clicks

    def _check(self, click: Click) -> None:
        width, height = self._clip.size_px
        if click.drawn_in not in range(PASSES) or click.frame not in self._clip.frames:
            raise InputError(
                f"a click on frame {click.frame}, which is not labelled here: load the page anew"
            )
        if not (-1.0 <= click.x <= width and -1.0 <= click.y <= height):
            raise InputError(f"a click at {click.x:g}, {click.y:g} is outside the frame: click inside")
        if len(self._clicks) > MOST_CLICKS:
            raise InputError(f"more than {MOST_CLICKS} clicks: begin anew")
