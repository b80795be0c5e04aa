"""`rig train`, `rig train-angle`, `rig train-turning`: train networks (extra `train`)."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rig.cli.common import emit_json, print_result, say
from rig.cli.declared import argument, option
from rig.cli.options import JsonOption, SeedOption
from rig.cli.places import folder_place

if TYPE_CHECKING:
    from rig.training.settings import TrainSettings

EPOCHS, PAPER_EPOCHS = 10, 30


@dataclass(frozen=True, slots=True)
class TrainOptions:
    """The images that networks are trained and tested on, and the folder of the results."""

    out: Path = option(..., "Folder for checkpoints, ONNX files and cards.", callback=folder_place)
    data: str = option(
        "simulated",
        "simulated, or a FOLDER: the paper's data set (VISTASE), LabelMe files, or simulated "
        "sessions of rig record.",
    )
    fold: list[str] | None = option(
        None, "D_s1, D_s2 or D_s3 (by object id, paper Table I); repeat for more."
    )
    everything: bool = option(False, "All four networks on all three folds: the paper's Table II.", "--all")
    images: int = option(
        1500, "Simulated frames to train on, a fold; a fifth more to validate and test.", min=24
    )
    units: str = option(
        "varied",
        "Simulated sensors: varied (unlike one another, to carry over to unseen ones) or family "
        "(of one make, as the paper's).",
    )
    seed: SeedOption = 0
    resume: bool = option(False, "Continue the session in --out.")
    json: JsonOption = False


@dataclass(frozen=True, slots=True)
class NetworkOptions:
    """The networks, and how they are trained."""

    arch: list[str] | None = option(None, "ours, pspnet, deeplabv3plus or unetplusplus; repeat for more.")
    paper: bool = option(False, "The paper's settings (256 x 320 px, 30 epochs); wants a GPU.")
    epochs: int | None = option(None, "Default: 10; 30 with --paper.", min=1)
    encoder: str = option("resnet18", "Encoder of the paper's networks: resnet18 or efficientnet-b3.")
    encoder_weights: Path | None = option(
        None, "File with encoder weights to begin with. Default: random ones."
    )
    threads: int | None = option(None, "Threads. Default: torch's own.", min=1)


@dataclass(frozen=True, slots=True)
class AngleOptions:
    """The network, and the lifts that it is trained on."""

    network: str = argument(..., "anglenet (an angle from one image) or toskov (from the wrist's wrench).")
    data: list[Path] | None = option(None, "Session of rig trial; repeat for more. Default: SIMULATED lifts.")
    lifts: int | None = option(
        None, "Simulated lifts of each object. Default: toskov 120, anglenet 5.", min=1
    )
    epochs: int | None = option(None, "Default: toskov 120, anglenet 8.", min=1)
    on_test_lifts: bool = option(
        False,
        "Learn from the lifts of --data that are then scored, as the paper trained AngleNet. "
        "Default: the trial's objects are scored and never learnt from.",
    )


@dataclass(frozen=True, slots=True)
class TurningOptions:
    """The simulated data."""

    faces: int = option(2600, "SIMULATED faces to learn from, six pictures each.", min=2)
    epochs: int = option(8, "How often each picture is seen.", min=1)


@dataclass(frozen=True, slots=True)
class RunOptions:
    """The folder of one network, and how it is trained."""

    out: Path = option(..., "Empty folder for the ONNX file and its card.", callback=folder_place)
    threads: int | None = option(None, "Threads. Default: torch's own.", min=1)
    seed: SeedOption = 0
    json: JsonOption = False

    def finish(self, card: dict[str, Any], summary: str) -> None:
        """Print what was trained."""
        say(summary)
        print_result(self.json, {"out": str(self.out), **card}, self.out / "model.onnx")


def train(options: TrainOptions, networks: NetworkOptions) -> None:
    """Train networks that find the contact, score them on objects they never saw, export them to ONNX.

    OUT/NETWORK_FOLD gets model.onnx (fp32), model.half.onnx (fp16), model.int8.onnx and card.json;
    rig segment --model takes any of them. Without --data FOLDER everything is SIMULATED.
    Needs the extra `train`.

    Examples:
      rig train --arch ours --images 9000 --epochs 10 --out runs/ours

      rig train --arch pspnet --fold D_s3 --data VISTASE --out runs/vistase --resume

      rig train --all --units family --out runs/table2 --resume

    """
    require_training()
    from rig.live.terminal import TrainingView
    from rig.training.run import train_all

    settings, data = _settings(options, networks), options.data
    say(f"{'SIMULATED frames' if data == 'simulated' else data}, seed {options.seed}, into {options.out}")
    with TrainingView() as view:
        cards = train_all(options.out, settings, options.resume, view)
    _print(cards, options.json)
    if options.json:
        emit_json({"out": str(options.out), "models": cards})


def _settings(options: TrainOptions, networks: NetworkOptions) -> "TrainSettings":
    from rig.labels.datasets import FOLDS, find_fold
    from rig.training.networks import ARCHITECTURES, find_architecture
    from rig.training.settings import TrainSettings, checked_units

    architectures = ARCHITECTURES if options.everything else networks.arch or ["ours"]
    return TrainSettings(
        data=options.data,
        architectures=tuple(map(find_architecture, architectures)),
        folds=tuple(map(find_fold, FOLDS if options.everything else options.fold or ["D_s3"])),
        encoder=networks.encoder,
        images=options.images,
        epochs=networks.epochs or (PAPER_EPOCHS if networks.paper else EPOCHS),
        paper=networks.paper,
        seed=options.seed,
        encoder_weights=networks.encoder_weights,
        threads=networks.threads,
        units=checked_units(options.units),
    )


def train_angle(options: AngleOptions, run: RunOptions) -> None:
    """Train a network of the paper's peers (its Table IV) that estimates an angle, and export it to ONNX.

    OUT gets model.onnx and card.json; rig benchmark trials takes it with --model anglenet=FILE or
    toskov=FILE. Needs the extra `train`.

    Examples:
      rig train-angle toskov --out runs/toskov

      rig train-angle anglenet --data sessions/others --data sessions/trial --out runs/anglenet

      rig train-angle anglenet --data trials/session --on-test-lifts --out runs/anglenet-on-test

    """
    require_training()
    from drivers.errors import unknown_name
    from rig.live.terminal import TrainingView
    from rig.training.angles import EPOCHS, LIFTS, AngleSettings, train_angles

    name, sessions = options.network, tuple(options.data or ())
    if name not in LIFTS:
        raise unknown_name("network", name, LIFTS)
    lifts, epochs = options.lifts or LIFTS[name], options.epochs or EPOCHS[name]
    settings = AngleSettings(name, sessions, lifts, epochs, run.seed, options.on_test_lifts, run.threads)
    say(f"{name} from {', '.join(map(str, sessions)) or 'SIMULATED lifts'}, seed {run.seed}, into {run.out}")
    with TrainingView() as view:
        card = train_angles(run.out, settings, view)
    test, simulated = card["test"], "SIMULATED: " if card["simulated"] else ""
    scored = "the lifts it learnt from" if options.on_test_lifts else "objects it never saw"
    run.finish(
        card,
        f"{simulated}{card['title']}, {card['parameters']} parameters: off by {test['error_deg']:.2f} deg "
        f"in the mean on {scored}; 0 all the time is off by {test['saying_zero_deg']:.2f} deg",
    )


def train_turning(options: TurningOptions, run: RunOptions) -> None:
    """Train the network by which slip tells what of a contact turns with the object, and export it to ONNX.

    OUT gets model.onnx and card.json. slip runs the one that is shipped, rig/models/turning.onnx. Takes a
    quarter of an hour on two cores, and 2 GB of memory. Needs the extra `train`.

    Examples:
      rig train-turning --out runs/turning

      rig train-turning --faces 200 --epochs 2 --out runs/quick

    """
    require_training()
    from rig.live.terminal import TrainingView
    from rig.training.turning_net import train_turning

    say(f"turning from {options.faces} SIMULATED faces, seed {run.seed}, into {run.out}")
    with TrainingView() as view:
        card = train_turning(run.out, options.faces, options.epochs, run.seed, run.threads, view)
    error = min(card["validation_error"])
    run.finish(card, f"SIMULATED: the share that turns is off by {error:.3f} on other faces")


def require_training() -> None:
    """Raise `InputError` that says what to install where the extra is missing."""
    from importlib.util import find_spec

    from drivers.errors import InputError

    needed = ("torch", "segmentation_models_pytorch", "onnx", "onnxscript")
    if missing := [name for name in needed if find_spec(name) is None]:
        raise InputError(
            f'{", ".join(missing)} not installed: training is an extra: pip install -e ".[train]" '
            "(on a computer without GPU, install torch's CPU build first)"
        )


def _print(cards: list[dict[str, Any]], to_stderr: bool) -> None:
    from rig.live.tables import console_table, table_console

    columns = ("network", "fold", "Dice", "IoU", "ms per frame", "int8 Dice", "settings")
    simulated = "SIMULATED objects" if all(card["simulated"] for card in cards) else "objects"
    title = f"Test {simulated} that training never saw, mean ± standard deviation"
    table = console_table(columns, map(_cells, cards), range(len(columns)), title)
    table_console(to_stderr).print(table)


def _cells(card: dict[str, Any]) -> list[str]:
    test, int8 = card["test"], card["files"]["int8"]
    dice, iou = (f"{test[name]:.3f} ± {test[f'{name}_std']:.3f}" for name in ("dice", "iou"))
    figures = dice, iou, f"{card['ms_per_frame']:.2f}", f"{int8['dice']:.3f}"
    return [card["title"], card["fold"]["name"], *figures, card["settings"]]
