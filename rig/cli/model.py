"""`rig model`, `rig estimators`: networks and estimators that are installed; import of checkpoints."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rig.cli.common import emit_json, print_result, say
from rig.cli.declared import argument, option
from rig.cli.helping import Commands
from rig.cli.options import JsonOption
from rig.cli.places import file_place

model = Commands(no_args_is_help=True, help="List the networks that are shipped; import others' checkpoints.")


def estimators(json: JsonOption = False) -> None:
    """List the estimators that are here: the rig's own, and those that installed packages offer.

    Nothing is imported: a package says in its own metadata what it offers, as entry points of the group
    slip_rig.estimators. A class that is in no list is named in full, as package.module:Class.

    Examples:
      rig estimators

      rig estimators --json

    """
    from drivers.named_classes import installed_classes
    from rig.live.tables import console_table, table_console
    from rig.tactile.estimators import DEFAULT_ESTIMATOR, ESTIMATORS
    from rig.tactile.foreign import GROUP

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
    """Show the shipped networks: what they see, what they were trained on, how well they do.

    Examples:
      rig model list

      rig model list --json

    """
    from rig.frames.masks import shipped_cards

    cards = shipped_cards()
    if json:
        emit_json({"models": cards})
    else:
        _print(cards)


@dataclass(frozen=True, slots=True)
class ImportOptions:
    """The checkpoint, its network, and the ONNX file."""

    checkpoint: Path = argument(..., "PyTorch checkpoint: a state dict, bare or under state_dict.")
    out: Path = option(..., "ONNX file to write; its card goes beside it.", callback=file_place)
    arch: str = option("pspnet", "pspnet, deeplabv3plus, unetplusplus or ours.")
    encoder: str = option("resnet18", "resnet18 or efficientnet-b3.")
    size: str = option("256x320", "WIDTHxHEIGHT in px of the images it was trained on.")
    threshold: float = option(0.7, "On the sigmoid; the paper's is 0.7.", min=0.01, max=0.99)
    json: JsonOption = False


@model.command("import")
def import_model(options: ImportOptions) -> None:
    """Turn a checkpoint of segmentation-models-pytorch into ONNX that rig segment runs.

    This is the format in which the paper's authors publish their weights. Code inside the file is
    never run. Needs the extra `train`.

    Examples:
      rig model import PSPNet_resnet18.pth --arch pspnet --out authors.onnx

      rig segment frames/ --model authors.onnx --out masks

    """
    from rig.cli.train import require_training

    require_training()
    from rig.training.checkpoint import import_checkpoint
    from rig.training.networks import find_architecture

    arch, size, out = find_architecture(options.arch), _size(options.size), options.out
    card = import_checkpoint(options.checkpoint, arch, options.encoder, size, options.threshold, out)
    difference = card["largest_difference_from_library"]
    say(
        f"{out}: {card['title']}, {card['files']['fp32']['bytes'] / 1e6:.1f} MB; logits differ from the "
        f"library's by at most {difference:.1g}"
    )
    print_result(options.json, {"out": str(out), **card}, out)


def _size(text: str) -> tuple[int, int]:
    """Return (height, width) from WIDTHxHEIGHT."""
    from drivers.errors import InputError

    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if match is None:
        raise InputError(f"--size {text}: give WIDTHxHEIGHT in px, as 256x320")
    return int(match[2]), int(match[1])


def _print(cards: list[dict[str, Any]]) -> None:
    from rig.live.tables import console_table, table_console

    columns = ("network", "sees", "px", "trained on", "test Dice", "test IoU", "file", "MB")
    title = "Shipped networks; Dice and IoU on objects never trained on"
    table_console().print(console_table(columns, map(_cells, cards), range(len(columns)), title))


def _cells(card: dict[str, Any]) -> list[str]:
    data = "SIMULATED frames" if card["simulated"] else card["data"]
    (width, height), test, shipped = card["size_px"], card["test"], card["shipped"]
    return [
        card["name"], card["inputs"], f"{width} x {height}", f"{data}, {card['fold']['name']}",
        f"{test['dice']:.3f}", f"{test['iou']:.3f}", shipped["file"], f"{shipped['bytes'] / 1e6:.2f}",
    ]  # fmt: skip
