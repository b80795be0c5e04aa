"""Train an angle network that the paper compares with (its Table IV), and export it to ONNX.

    python tools/train_angle.py toskov --out runs/toskov
    python tools/train_angle.py anglenet --data sessions/others --data sessions/trial --out runs/anglenet
    python tools/train_angle.py anglenet --data trials/session --on-test-lifts --out runs/anglenet-on-test

The folder of --out then holds model.onnx and card.json (its metadata). Use the network in
`rig benchmark trials` with --model anglenet=FILE or --model toskov=FILE. Needs the extra `train`.
"""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable
from functools import partial
from pathlib import Path

from command_line import run_training, training_parser


def train(options: Namespace, report: Callable[[str, float], None]) -> str:
    """Train, and return the summary."""
    from angle_nets import EPOCHS, LIFTS, AngleSettings, train_angles

    name = options.network
    settings = AngleSettings(
        name, tuple(options.data), options.lifts or LIFTS[name], options.epochs or EPOCHS[name], options.seed,
        options.on_test_lifts, options.threads,
    )  # fmt: skip
    card = train_angles(options.out, settings, report)
    test, simulated = card["test"], "SIMULATED: " if card["simulated"] else ""
    scored = "the lifts it was trained on" if options.on_test_lifts else "objects it was not trained on"
    return (
        f"{simulated}{card['title']}, {card['parameters']} parameters: mean absolute error "
        f"{test['error_deg']:.2f} deg on {scored}; always predicting 0 has {test['saying_zero_deg']:.2f} deg"
    )


def options_parser() -> ArgumentParser:
    """Return the parser of the command line."""
    parser = training_parser(__doc__)
    parser.add_argument(
        "network", choices=["anglenet", "toskov"],
        help="anglenet: angle from one image; toskov: angle from the wrench at the wrist",
    )  # fmt: skip
    parser.add_argument(
        "--data", type=Path, action="append", default=[],
        help="session of rig trial to train on; repeat for more. Default: SIMULATED lifts",
    )  # fmt: skip
    parser.add_argument(
        "--lifts", type=int, help="simulated lifts per object; default: 120 for toskov, 5 for anglenet"
    )
    parser.add_argument("--epochs", type=int, help="default: 120 for toskov, 8 for anglenet")
    parser.add_argument(
        "--on-test-lifts", action="store_true",
        help="train on the lifts of --data that are used for the test, too, as the paper trained AngleNet; "
        "by default the trial's objects are used for the test only",
    )  # fmt: skip
    return parser


if __name__ == "__main__":
    run_training(partial(train, options_parser().parse_args()))
