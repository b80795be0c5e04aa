"""`rig train-turning`: train the network that tells what of a texture turns (extra `train`)."""

from pathlib import Path
from typing import Annotated

import typer

from rig.cli.common import JsonOption, SeedOption, emit_json, say
from rig.cli.places import folder_place


def train_turning(
    out: Annotated[
        Path,
        typer.Option("--out", help="Empty folder for the ONNX file and its card.", callback=folder_place),
    ],
    faces: Annotated[
        int, typer.Option(min=2, help="SIMULATED faces to learn from, six pictures each.")
    ] = 2600,
    epochs: Annotated[int, typer.Option(min=1, help="How often each picture is seen.")] = 8,
    threads: Annotated[int | None, typer.Option(min=1, help="Threads. Default: torch's own.")] = None,
    seed: SeedOption = 0,
    json: JsonOption = False,
) -> None:
    """Train the network by which slip tells what of a contact turns with the object, and export it to ONNX.

    OUT gets model.onnx and card.json. slip runs the one that is shipped, rig/models/turning.onnx. Takes a
    quarter of an hour on two cores, and 2 GB of memory. Needs the extra `train`.

    Examples:
      rig train-turning --out runs/turning

      rig train-turning --faces 200 --epochs 2 --out runs/quick

    """
    from rig.cli.train import TrainingView, require_training

    require_training()
    from rig.training.turning_net import train_turning

    say(f"turning from {faces} SIMULATED faces, seed {seed}, into {out}")
    with TrainingView() as view:
        card = train_turning(out, faces, epochs, seed, threads, view)
    say(f"SIMULATED: the share that turns is off by {min(card['validation_error']):.3f} on other faces")
    if json:
        emit_json({"out": str(out), **card})
    else:
        print(out / "model.onnx")
