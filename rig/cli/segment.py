"""`rig segment`: write contact masks of tactile images. `rig label`: propose labels to correct by hand."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from drivers.errors import InputError, plural
from rig.cli.common import emit_json, say
from rig.cli.options import JsonOption
from rig.declared import folder_place, option

if TYPE_CHECKING:
    from rig.frames.masks import ImageGroup, SegmentChoice

ImagesArgument = Annotated[
    list[Path], typer.Argument(help="Images, folders of images, or sessions of rig record.")
]
BackgroundOption = Annotated[
    str | None,
    typer.Option(
        help="Frame without contact: an IMAGE, first:N (mean of the first N images) or auto (computed from "
        "all images). Default: that of the session; else auto if there are at least nine images."
    ),
]
MarginOption = Annotated[
    float,
    typer.Option(
        help="Offset of the mask's outline as a fraction of the image width: positive is larger, negative "
        "smaller. 0 matches the labels of the training data."
    ),
]


@dataclass(frozen=True, slots=True)
class SegmentOptions:
    images: ImagesArgument
    out: Path = option(..., "Folder for the masks.", callback=folder_place)
    background: BackgroundOption = None
    model: str = option("ours", "Network: ours, pspnet, classical (no network), or the path of an ONNX file.")
    margin: MarginOption = 0.0
    threads: int = option(1, "Threads per inference.", min=1, max=64)
    json: JsonOption = False


@dataclass(frozen=True, slots=True)
class LabelOptions:
    images: ImagesArgument
    out: Path = option(..., "Folder for labels, masks/ and coco.json.", callback=folder_place)
    background: BackgroundOption = None
    model: str = option(
        "classical",
        "Source of the proposals: classical (difference from the background), ours, pspnet or an ONNX file.",
    )
    margin: MarginOption = 0.0
    json: JsonOption = False


def segment(options: SegmentOptions) -> None:
    """Write a contact mask STEM.png for every image, of the same size, with values 0 and 255.

    The network ours compares each image with a frame without contact; pspnet needs only the image. Both were
    trained on SIMULATED frames. Their masks are the convex hull of each part of the contact. Black and
    saturated images get an empty mask, unreadable images get none. The JSON output has the state of every
    image.

    Examples:
      rig segment frames/ --out masks
      rig segment a.png b.png --background empty.png --out masks --margin -0.01
      rig segment sessions/mug --model pspnet --out masks --json
    """
    from drivers.images import encode_png
    from rig.frames.masks import SegmentChoice, mask_figures, segment_groups
    from rig.sessions.files import write_file

    choice = SegmentChoice(options.model, options.margin, options.threads)
    groups, names = _images(options, choice, options.out, ".png")
    rows = []
    for done in segment_groups(groups, choice):
        if done.image is not None:
            write_file(names[done.file], encode_png(done.mask))
        if done.state in ("black", "saturated", "unreadable"):
            say(f"warning: {done.file}: {done.state}")
        rows.append(done.as_json(None if done.image is None else names[done.file]))
    states, median_ms = mask_figures(rows)
    if list(states) == ["unreadable"]:
        raise InputError(f"{options.images[0]}: none of the images can be read; copy them again")
    counts = ", ".join(f"{count} {state}" for state, count in states.items())
    say(f"{options.model}: {counts}; {median_ms} ms per image (median); masks in {options.out}")
    if options.json:
        about = {"out": str(options.out), "background": [group.note for group in groups]}
        figures = {"model": options.model, "states": states, "median_ms": median_ms}
        emit_json({**about, **figures, "images": rows})


def label(options: LabelOptions) -> None:
    """Propose a LabelMe polygon around the contact of each image, and export all labels.

    The proposals are OUT/STEM.json. Correct them in LabelMe (labelme IMAGES --output OUT), then run the same
    command again: it never changes an existing label file, and writes OUT/masks and OUT/coco.json from the
    corrected labels.

    Examples:
      rig label frames/ --background empty.png --out labels
      rig label sessions/mug --out labels --json
    """
    from rig.frames.masks import SegmentChoice, segment_groups
    from rig.labels.label_files import COCO, MASKS, export_masks, outline_contact, propose, write_coco

    out, model = options.out, options.model
    choice, files = SegmentChoice(model, options.margin), []
    groups, names = _images(options, choice, out / MASKS, ".json")
    for done in segment_groups(groups, choice):
        if done.image is None:
            say(f"warning: {done.file}: unreadable, no label")
        else:
            origin = f"proposed by rig label, {model}; not yet looked at by a person"
            files.append(propose(done.file, done.mask, names[done.file], origin))
    masks = export_masks(files, out / MASKS)
    labelled = [outline_contact(file.image, mask) for file, mask in zip(files, masks, strict=True)]
    proposed = sum(file.proposed for file in files)
    kept = len(files) - proposed
    write_coco(out / COCO, labelled, f"contact labels; {proposed} of {len(files)} proposed just now")
    say(
        f"{plural(proposed, 'label')} proposed, {kept} existing kept, in {out}; "
        f"masks and {COCO} hold all of them"
    )
    if options.json:
        labels = [str(file.path) for file in files]
        emit_json({"out": str(out), "model": model, "proposed": proposed, "kept": kept, "labels": labels})


def _images(
    options: SegmentOptions | LabelOptions, choice: "SegmentChoice", folder: Path, ending: str
) -> "tuple[list[ImageGroup], dict[Path, Path]]":
    """Create the folder; return the images and the output file of each. Raises `InputError`."""
    from rig.frames.masks import image_groups, make_folder, needs_background, output_names

    groups = image_groups(options.images, options.background, needs_background(choice))
    names = output_names(groups, options.out, ending)
    make_folder(folder)
    for note in dict.fromkeys(group.note for group in groups):
        say(note)
    return groups, names
