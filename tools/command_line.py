"""Code that both trainings use: common options, and how a training runs from the command line.

To train a network, run `python tools/train_angle.py --help` or `python tools/train_turning.py --help`.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # threads of several processes wait for each other

import sys
from argparse import ArgumentParser, RawDescriptionHelpFormatter
from collections.abc import Callable
from pathlib import Path

from drivers.errors import RigError
from rig.cli.train import require_training
from rig.terminal.progress import training_view


def training_parser(description: str | None) -> ArgumentParser:
    """Return a parser with the options of every training."""
    parser = ArgumentParser(description=description, formatter_class=RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="empty folder for the ONNX file and its card")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--threads", type=int, help="CPU threads; default: as torch chooses")
    return parser


def run_training(train: Callable[[Callable[[str, float], None]], str]) -> None:
    """Train while the progress is printed, then print the summary. Errors of the rig are one line.

    train: takes the function that shows the progress, returns the summary.
    """
    try:
        require_training()
        with training_view() as view:
            summary = train(view)
    except RigError as error:
        sys.exit(str(error))
    print(summary)
