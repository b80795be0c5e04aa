"""`rig model`, `rig estimators`: list installed networks and estimators, import checkpoints."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers.errors import InputError
from rig.cli.common import emit_json, print_result, say
from rig.cli.helping import Commands
from rig.cli.options import JsonOption
from rig.cli.train import require_training
from rig.declared import argument, file_place, option

model = Commands(no_args_is_help=True, help="List the networks of the rig; import a checkpoint of your own.")


def estimators(json: JsonOption = False) -> None:
    """List the available estimators: the rig's own and those of installed packages.

    A package lists its estimators in its metadata, as entry points of the group slip_rig.estimators. They
    are read without importing the package. Any other class is named as package.module:Class.

    Examples:
      rig estimators
      rig estimators --json
    """
    from drivers.named_classes import installed_classes
    from rig.tactile.estimators import DEFAULT_ESTIMATOR, ESTIMATORS
    from rig.tactile.foreign import GROUP
    from rig.terminal.tables import console_table, table_console

    found: list[dict[str, Any]] = [{"name": name, "from": "the rig", "class": None} for name in ESTIMATORS]
    for of in installed_classes(GROUP):
        hidden = of.name in ESTIMATORS
        found.append({"name": of.target if hidden else of.name, "from": of.distribution, "class": of.target})
    if json:
        emit_json({"default": DEFAULT_ESTIMATOR, "estimators": found})
        return
    rows = [(str(of["name"]), str(of["from"]), str(of["class"] or "")) for of in found]
    table_console().print(console_table(("--estimator", "from", "class"), rows, range(3)))


@model.command("list")
def list_models(json: JsonOption = False) -> None:
    """List the networks of the rig with their inputs, training data and test scores.

    Examples:
      rig model list
      rig model list --json
    """
    from rig.frames.masks import shipped_cards
    from rig.terminal.tables import console_table, table_console

    cards, rows = shipped_cards(), []
    if json:
        emit_json({"models": cards})
        return
    for card in cards:
        data = "SIMULATED frames" if card["simulated"] else card["data"]
        (width, height), test, shipped = card["size_px"], card["test"], card["shipped"]
        about = card["name"], card["inputs"], f"{width} x {height}", f"{data}, {card['fold']['name']}"
        size = shipped["file"], f"{shipped['bytes'] / 1e6:.2f}"
        rows.append((*about, f"{test['dice']:.3f}", f"{test['iou']:.3f}", *size))
    columns = ("network", "input", "px", "trained on", "test Dice", "test IoU", "file", "MB")
    title = "Networks of the rig; Dice and IoU on objects that are not in the training data"
    table_console().print(console_table(columns, rows, range(len(columns)), title))


@dataclass(frozen=True, slots=True)
class ImportOptions:
    checkpoint: Path = argument(
        ..., "PyTorch checkpoint: a state dict, or a dictionary with one under the key state_dict."
    )
    out: Path = option(
        ..., "ONNX file to write. Its metadata goes into a .json file of the same name.", callback=file_place
    )
    arch: str = option("pspnet", "Architecture: pspnet, deeplabv3plus, unetplusplus or ours.")
    encoder: str = option("resnet18", "Encoder: resnet18 or efficientnet-b3.")
    size: str = option("256x320", "Size of the training images, WIDTHxHEIGHT in px.")
    threshold: float = option(
        0.7, "A pixel is contact if its sigmoid output is above this; the paper uses 0.7.", min=0.01, max=0.99
    )
    json: JsonOption = False


@model.command("import")
def import_model(options: ImportOptions) -> None:
    """Convert a checkpoint of segmentation-models-pytorch to ONNX, for rig segment.

    The paper's authors publish their weights in this format. Code inside the file is never run. Needs the
    extra `train`.

    Examples:
      rig model import PSPNet_resnet18.pth --arch pspnet --out authors.onnx
      rig segment frames/ --model authors.onnx --out masks
    """
    require_training()
    from rig.training.checkpoint import import_checkpoint
    from rig.training.networks import find_architecture

    arch, out = find_architecture(options.arch), options.out
    size = re.fullmatch(r"(\d{1,5})x(\d{1,5})", options.size)
    if size is None:
        raise InputError(f"--size {options.size}: give WIDTHxHEIGHT in px, as 256x320")
    card = import_checkpoint(
        options.checkpoint, arch, options.encoder, (int(size[2]), int(size[1])), options.threshold, out
    )
    difference = card["largest_difference_from_library"]
    say(
        f"{out}: {card['title']}, {card['files']['fp32']['bytes'] / 1e6:.1f} MB; logits differ from the "
        f"library's by at most {difference:.1g}"
    )
    print_result(options.json, {"out": str(out), **card}, out)
