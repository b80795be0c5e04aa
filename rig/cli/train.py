"""`rig train`, `model`, `estimators`: networks, and a list of estimators."""

import re
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.errors import InputError
from rig.cli.common import emit_json, print_result, say
from rig.cli.helping import Commands
from rig.cli.options import JsonOption, SeedOption
from rig.declared import argument, file_place, folder_place, option
from rig.terminal.progress import training_view

if TYPE_CHECKING:
    from rig.labels.datasets import Fold

EPOCHS, PAPER_EPOCHS = 10, 30


@dataclass(frozen=True, slots=True)
class TrainOptions:
    out: Path = option(
        ..., "Folder for checkpoints, ONNX files and cards (their metadata).", callback=folder_place
    )
    data: str = option(
        "simulated",
        "Training data: simulated, or a FOLDER with the paper's data set (VISTASE), LabelMe files, or "
        "simulated sessions of rig record.",
    )
    fold: list[str] | None = option(
        None, "Fold of the objects (paper, Table I): D_s1, D_s2 or D_s3; repeat for more."
    )
    validate: list[str] | None = option(
        None,
        "In place of a fold, with --data FOLDER: the object, or a folder in FOLDER such as a session, that "
        "chooses the best epoch; repeat for more. All others are trained on.",
    )
    test: list[str] | None = option(
        None, "With --validate: object or folder to test on. Default: those of --validate."
    )
    everything: bool = option(
        False, "Train all four networks on all three folds, as in the paper's Table II.", "--all"
    )
    images: int = option(
        1500, "Simulated training frames per fold; a fifth more are made for validation and test.", min=24
    )
    units: str = option(
        "varied",
        "Simulated sensors: varied (with random differences, to generalise to other sensors), the look of a "
        "real one (tactile-SERIAL.npz; every second sensor is a variation of it) or family "
        "(of one make, as the paper's).",
    )
    seed: SeedOption = 0
    resume: bool = option(False, "Continue the run in --out.")
    json: JsonOption = False
    arch: list[str] | None = option(
        None, "Network: ours, pspnet, deeplabv3plus or unetplusplus; repeat for more. Default: ours."
    )
    paper: bool = option(False, "Use the paper's settings (256 x 320 px, 30 epochs); slow without a GPU.")
    epochs: int | None = option(None, "Training epochs. Default: 10; 30 with --paper.", min=1)
    encoder: str = option("resnet18", "Encoder of the paper's networks: resnet18 or efficientnet-b3.")
    encoder_weights: Path | None = option(
        None, "File with initial weights of the encoder. Default: random weights."
    )
    threads: int | None = option(None, "CPU threads. Default: as torch chooses.", min=1)


def train(options: TrainOptions) -> None:
    """Train segmentation networks for the contact, test them on other objects, and export them to ONNX.

    The folder OUT/NETWORK_FOLD then holds model.onnx (fp32), model.half.onnx (fp16), model.int8.onnx and
    card.json. Each of the models can be used in rig segment --model. Without --data FOLDER all images are
    SIMULATED. Needs the extra `train`.

    Examples:
      rig train --arch ours --images 9000 --epochs 10 --out runs/ours
      rig train --arch pspnet --fold D_s3 --data VISTASE --out runs/vistase --resume
      rig train --data recordings --validate my_box --out runs/own
      rig train --all --units family --out runs/table2 --resume
    """
    require_training()
    from rig.terminal.tables import console_table, table_console
    from rig.training.networks import ARCHITECTURES, find_architecture
    from rig.training.run import TrainSettings, checked_units, train_all

    data, architectures = options.data, ARCHITECTURES if options.everything else options.arch or ["ours"]
    settings = TrainSettings(
        data=data,
        architectures=tuple(map(find_architecture, architectures)),
        folds=_choose_folds(options),
        encoder=options.encoder,
        images=options.images,
        epochs=options.epochs or (PAPER_EPOCHS if options.paper else EPOCHS),
        paper=options.paper,
        seed=options.seed,
        encoder_weights=options.encoder_weights,
        threads=options.threads,
        units=checked_units(options.units),
    )
    say(f"{'SIMULATED frames' if data == 'simulated' else data}, seed {options.seed}, into {options.out}")
    with training_view() as view:
        cards = train_all(options.out, settings, options.resume, view)
    rows = []
    for card in cards:
        test, used = card["test"], card["as_used"]
        scores = [f"{test[name]:.3f} ± {test[f'{name}_std']:.3f}" for name in ("dice", "iou")]
        small = [f"{card['files'][precision]['dice']:.3f}" for precision in ("fp16", "int8")]
        figures = (
            *scores,
            *small,
            "" if used is None else f"{used['dice']:.3f}",
            f"{card['ms_per_frame']:.2f}",
        )
        rows.append((card["title"], card["fold"]["name"], *figures))
    columns = ("network", "fold", "Dice", "IoU", "fp16 Dice", "int8 Dice", "Dice as used", "ms per frame")
    simulated = "SIMULATED objects" if all(card["simulated"] for card in cards) else "objects"
    unseen = not options.validate or options.test
    of = "that are not in the training data" if unseen else "that chose the best epoch (others: --test)"
    title = f"Test of the networks alone on {simulated} {of}, mean ± standard deviation. "
    title += "As used: with parts that the network missed, as in rig segment"
    table_console(options.json).print(console_table(columns, rows, range(len(columns)), title))
    if options.json:
        emit_json({"out": str(options.out), "models": cards})


def _choose_folds(options: TrainOptions) -> "tuple[Fold, ...]":
    """Return the folds of the options. Raises `InputError` for options that exclude one another."""
    from rig.labels.datasets import FOLDS, find_fold, own_fold

    if options.test and not options.validate:
        raise InputError("--test: name the objects that choose the best epoch as well, with --validate")
    if not options.validate:
        return tuple(map(find_fold, FOLDS if options.everything else options.fold or ["D_s3"]))
    if options.data == "simulated" or options.fold or options.everything:
        raise InputError("--validate: only with --data FOLDER, and without --fold and --all")
    return (own_fold(options.validate, options.test or ()),)


def require_training() -> None:
    """Raise `InputError` with the command to install the extra `train` if a package of it is missing."""
    from rig.config.extras import pip_line

    needed = ("torch", "segmentation_models_pytorch", "onnx", "onnxscript")
    if missing := [name for name in needed if find_spec(name) is None]:
        raise InputError(
            f"{', '.join(missing)} not installed: training needs an extra: {pip_line('train')} "
            "(on a computer without a GPU, install the CPU build of torch first)"
        )


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
        name = of.value if of.name in ESTIMATORS else of.name
        package = "" if of.dist is None else f"{of.dist.name} {of.dist.version}"
        found.append({"name": name, "from": package, "class": of.value})
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
    from rig.training.export import import_checkpoint
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
