"""`rig label`: proposes contact labels for a person to correct, and exports them."""

from pathlib import Path
from typing import Annotated

import typer

from drivers.errors import counted
from rig.cli.common import JsonOption, emit_json, say
from rig.cli.places import folder_place
from rig.cli.segment import BackgroundOption, ImagesArgument, MarginOption


def label(
    images: ImagesArgument,
    out: Annotated[
        Path, typer.Option("--out", help="Folder for labels, masks/ and coco.json.", callback=folder_place)
    ],
    background: BackgroundOption = None,
    model: Annotated[
        str,
        typer.Option(
            help="What proposes: classical (difference from the background), ours, pspnet or an ONNX file."
        ),
    ] = "classical",
    margin: MarginOption = 0.0,
    json: JsonOption = False,
) -> None:
    """Propose a LabelMe polygon round the contact of each image, and export all labels.

    OUT/STEM.json is for LabelMe (labelme IMAGES --output OUT). A label file that is there already is
    never changed: correct it in LabelMe, then run the same command again, which writes OUT/masks
    and OUT/coco.json from the labels as they are now.

    Examples:
      rig label frames/ --background empty.png --out labels

      rig label sessions/mug --out labels --json

    """
    from rig.frames.masks import (
        SegmentChoice,
        image_groups,
        make_folder,
        needs_background,
        output_names,
        segment_groups,
    )
    from rig.labels.proposals import COCO, MASKS, export_coco, export_masks, propose

    choice = SegmentChoice(model, margin)
    groups = image_groups(images, background, needs_background(choice))
    names = output_names(groups, out, ".json")
    make_folder(out / MASKS)
    for note in dict.fromkeys(group.note for group in groups):
        say(note)
    origin = f"proposed by rig label, {model}; not yet looked at by a person"
    files = []
    for done in segment_groups(groups, choice):
        if done.image is None:
            say(f"warning: {done.file}: unreadable, no label")
        else:
            files.append(propose(done.file, done.mask, names[done.file], origin))
    masks = list(export_masks(files, out / MASKS))
    proposed = sum(file.proposed for file in files)
    export_coco(files, masks, out / COCO, f"contact labels; {proposed} of {len(files)} proposed just now")
    say(
        f"{counted(proposed, 'label')} proposed, {len(files) - proposed} kept as found, in {out}; "
        f"masks and {COCO} are of all of them"
    )
    if json:
        figures = {"proposed": proposed, "kept": len(files) - proposed}
        emit_json({"out": str(out), "model": model, **figures, "labels": [str(f.path) for f in files]})
