"""`rig model`: the networks that are here, and others' checkpoints made to run."""

import re
from pathlib import Path
from typing import Annotated, Any

import typer

from rig.cli.common import JsonOption, emit_json, say
from rig.cli.helping import Commands
from rig.cli.places import file_place

model = Commands(no_args_is_help=True, help="List the networks that are shipped; import others' checkpoints.")


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


@model.command("import")
def import_model(
    checkpoint: Annotated[
        Path, typer.Argument(help="PyTorch checkpoint: a state dict, bare or under state_dict.")
    ],
    out: Annotated[
        Path, typer.Option("--out", help="ONNX file to write; its card goes beside it.", callback=file_place)
    ],
    arch: Annotated[str, typer.Option(help="pspnet, deeplabv3plus, unetplusplus or ours.")] = "pspnet",
    encoder: Annotated[str, typer.Option(help="resnet18 or efficientnet-b3.")] = "resnet18",
    size: Annotated[
        str, typer.Option(help="WIDTHxHEIGHT in px of the images it was trained on.")
    ] = "256x320",
    threshold: Annotated[
        float, typer.Option(min=0.01, max=0.99, help="On the sigmoid; the paper's is 0.7.")
    ] = 0.7,
    json: JsonOption = False,
) -> None:
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

    card = import_checkpoint(checkpoint, find_architecture(arch), encoder, _size(size), threshold, out)
    difference = card["largest_difference_from_library"]
    say(
        f"{out}: {card['title']}, {card['files']['fp32']['bytes'] / 1e6:.1f} MB; logits differ from the "
        f"library's by at most {difference:.1g}"
    )
    if json:
        emit_json({"out": str(out), **card})
    else:
        print(out)


def _size(text: str) -> tuple[int, int]:
    """Return (height, width) from WIDTHxHEIGHT."""
    from drivers.errors import InputError

    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if match is None:
        raise InputError(f"--size {text}: give WIDTHxHEIGHT in px, as 256x320")
    return int(match[2]), int(match[1])


def _print(cards: list[dict[str, Any]]) -> None:
    from rich.table import Table

    from rig.cli.fitting import table_console

    table = Table("network", "sees", "px", "trained on", "test Dice", "test IoU", "file", "MB")
    table.title = "Shipped networks; Dice and IoU on objects never trained on"
    for card in cards:
        data = "SIMULATED frames" if card["simulated"] else card["data"]
        width, height = card["size_px"]
        table.add_row(
            card["name"],
            card["inputs"],
            f"{width} x {height}",
            f"{data}, {card['fold']['name']}",
            f"{card['test']['dice']:.3f}",
            f"{card['test']['iou']:.3f}",
            card["shipped"]["file"],
            f"{card['shipped']['bytes'] / 1e6:.2f}",
        )
    table_console().print(table)
