"""`rig segment`: contact masks of anyone's tactile images."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rig.cli.common import JsonOption, emit_json, say
from rig.cli.places import folder_place

if TYPE_CHECKING:
    from rig.frames.masks import SegmentedImage

ImagesArgument = Annotated[
    list[Path], typer.Argument(help="Images, folders of images, or sessions of rig record.")
]
BackgroundOption = Annotated[
    str | None,
    typer.Option(
        help="Frame without contact: an IMAGE, first:N (mean of the first N images) or auto (made from the "
        "images themselves). Default: a session's own; else auto, from nine images on."
    ),
]
MarginOption = Annotated[
    float,
    typer.Option(
        help="How loose masks are: their outline is moved out by this share of the image's width; "
        "negative is tighter. 0 is the label's definition."
    ),
]


def segment(
    images: ImagesArgument,
    out: Annotated[Path, typer.Option("--out", help="Folder for the masks.", callback=folder_place)],
    background: BackgroundOption = None,
    model: Annotated[
        str, typer.Option(help="ours, pspnet, classical (no network), or the path of an ONNX file.")
    ] = "ours",
    margin: MarginOption = 0.0,
    threads: Annotated[int, typer.Option(min=1, max=64, help="Threads of one inference.")] = 1,
    json: JsonOption = False,
) -> None:
    """Write the contact mask of every image: STEM.png, 0 or 255, at the image's own size.

    ours compares each image with a frame without contact; pspnet sees the image alone. Both were
    trained on SIMULATED frames and answer with the convex hull of each part of the contact. Black
    and saturated images get an empty mask, unreadable ones none; the JSON says which.

    Examples:
      rig segment frames/ --out masks

      rig segment a.png b.png --background empty.png --out masks --margin -0.01

      rig segment sessions/mug --model pspnet --out masks --json

    """
    from drivers.errors import InputError
    from rig.frames.masks import (
        SegmentChoice,
        image_groups,
        make_folder,
        needs_background,
        output_names,
        segment_groups,
    )

    choice = SegmentChoice(model, margin, threads)
    groups = image_groups(images, background, needs_background(choice))
    names = output_names(groups, out, ".png")
    make_folder(out)
    for note in dict.fromkeys(group.note for group in groups):
        say(note)
    rows: list[SegmentedFile] = []
    for done in segment_groups(groups, choice):
        if done.image is not None:
            _write_mask(names[done.file], done)
        rows.append(_row(done, names[done.file]))
        if done.state in ("black", "saturated", "unreadable"):
            say(f"warning: {done.file}: {done.state}")
    if all(row.state == "unreadable" for row in rows):
        raise InputError(f"{images[0]}: not one complete image: copy it anew")
    figures = _figures(model, rows)
    states = ", ".join(f"{count} {state}" for state, count in figures.states.items())
    say(f"{figures.model}: {states}; {figures.median_ms} ms per image (median); masks in {out}")
    if json:
        notes = [group.note for group in groups]
        emit_json(
            {"out": str(out), "background": notes, **asdict(figures), "images": [asdict(row) for row in rows]}
        )


@dataclass(frozen=True, slots=True)
class SegmentedFile:
    """What became of one image, as `--json` says it."""

    image: str
    mask: str | None
    state: str
    area_px: float
    ms: float


@dataclass(frozen=True, slots=True)
class SegmentFigures:
    """What became of all images."""

    model: str
    states: dict[str, int]
    median_ms: float | None


def _write_mask(path: Path, done: "SegmentedImage") -> None:
    from drivers.images import encode_png
    from rig.sessions.files import write_file

    write_file(path, encode_png(done.mask))


def _row(done: "SegmentedImage", name: Path) -> SegmentedFile:
    area = 0.0 if done.segmentation is None else done.segmentation.contact.area_px
    mask = None if done.image is None else str(name)
    return SegmentedFile(str(done.file), mask, done.state, area, round(1e3 * done.cost_s, 3))


def _figures(model: str, rows: list[SegmentedFile]) -> SegmentFigures:
    from collections import Counter
    from statistics import median

    states = dict(sorted(Counter(row.state for row in rows).items()))
    costs = [row.ms for row in rows if row.state != "unreadable"]
    return SegmentFigures(model, states, round(median(costs), 3) if costs else None)
