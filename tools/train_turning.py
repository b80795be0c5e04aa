"""Train the network of slip that marks the parts of a contact that turn with the object, and export it.

    python tools/train_turning.py --out runs/turning
    python tools/train_turning.py --faces 200 --epochs 2 --out runs/quick
    python tools/train_turning.py --faces 16600 --epochs 22 --out runs/as-shipped

The folder of --out then holds model.onnx and card.json (its metadata). The estimator slip uses the network
rig/models/turning.onnx, made from 16658 faces. Training takes about 15 minutes on two cores and 3 GB of
memory; with 16600 faces and 22 epochs, 3 hours and 16 GB. A GPU is used if there is one. Needs the extra
`train`.
"""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from functools import partial
from pathlib import Path

from command_line import run_training, training_parser


def train(options: Namespace, report: Callable[[str, float], None]) -> str:
    """Train, and return the summary."""
    from turning_net import train_turning

    card = train_turning(
        options.out, options.faces, options.epochs, options.seed, options.threads, report, options.look
    )
    return (
        f"SIMULATED: mean error of the turning share {min(card['validation_error']):.3f} on validation faces"
    )


def options_parser() -> ArgumentParser:
    """Return the parser of the command line."""
    parser = training_parser(__doc__)
    parser.add_argument(
        "--faces", type=int, default=2600,
        help="number of SIMULATED object faces to train on, at least 2, with six images each; default 2600",
    )  # fmt: skip
    parser.add_argument("--epochs", type=int, default=8, help="default 8")
    parser.add_argument(
        "--look", type=Path,
        help="look of a real sensor (.npz of rig calibrate tactile), which every second sensor varies",
    )  # fmt: skip
    return parser


if __name__ == "__main__":
    run_training(partial(train, options_parser().parse_args()))
