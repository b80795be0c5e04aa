"""`rig train`: train segmentation networks (extra `train`)."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Self

import typer

from rig.cli.common import JsonOption, ResumeOption, SeedOption, emit_json, say
from rig.cli.places import folder_place
from rig.live.screen import begin_phase

EPOCHS, PAPER_EPOCHS = 10, 30
ArchOption = Annotated[
    list[str] | None,
    typer.Option("--arch", help="ours, pspnet, deeplabv3plus or unetplusplus; repeat for more."),
]
EncoderOption = Annotated[
    str, typer.Option(help="Encoder of the paper's networks: resnet18 or efficientnet-b3.")
]


@dataclass(frozen=True, slots=True)
class DataOptions:
    """The images that networks are trained and tested on."""

    data: Annotated[
        str,
        typer.Option(
            help="simulated, or a FOLDER: the paper's data set (VISTASE), LabelMe files, or simulated "
            "sessions of rig record."
        ),
    ] = "simulated"
    fold: Annotated[
        list[str] | None,
        typer.Option("--fold", help="D_s1, D_s2 or D_s3 (by object id, paper Table I); repeat for more."),
    ] = None
    everything: Annotated[
        bool, typer.Option("--all", help="All four networks on all three folds: the paper's Table II.")
    ] = False
    images: Annotated[
        int,
        typer.Option(min=24, help="Simulated frames to train on, a fold; a fifth more to validate and test."),
    ] = 1500
    units: Annotated[
        str,
        typer.Option(
            help="Simulated sensors: varied (unlike one another, to carry over to unseen ones) or family "
            "(of one make, as the paper's)."
        ),
    ] = "varied"
    seed: SeedOption = 0


@dataclass(frozen=True, slots=True)
class NetworkOptions:
    """The networks, and how they are trained."""

    arch: ArchOption = None
    paper: Annotated[
        bool, typer.Option("--paper", help="The paper's settings (256 x 320 px, 30 epochs); wants a GPU.")
    ] = False
    epochs: Annotated[int | None, typer.Option(min=1, help="Default: 10; 30 with --paper.")] = None
    encoder: EncoderOption = "resnet18"
    encoder_weights: Annotated[
        Path | None, typer.Option(help="File with encoder weights to begin with. Default: random ones.")
    ] = None
    threads: Annotated[int | None, typer.Option(min=1, help="Threads. Default: torch's own.")] = None


def train(
    out: Annotated[
        Path,
        typer.Option("--out", help="Folder for checkpoints, ONNX files and cards.", callback=folder_place),
    ],
    data: DataOptions,
    networks: NetworkOptions,
    resume: ResumeOption = False,
    json: JsonOption = False,
) -> None:
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
    from rig.labels.datasets import FOLDS, find_fold
    from rig.training.networks import ARCHITECTURES, find_architecture
    from rig.training.run import train_all
    from rig.training.settings import TrainSettings, checked_units

    settings = TrainSettings(
        data=data.data,
        architectures=tuple(
            map(find_architecture, ARCHITECTURES if data.everything else networks.arch or ["ours"])
        ),
        folds=tuple(map(find_fold, FOLDS if data.everything else data.fold or ["D_s3"])),
        encoder=networks.encoder,
        images=data.images,
        epochs=networks.epochs or (PAPER_EPOCHS if networks.paper else EPOCHS),
        paper=networks.paper,
        seed=data.seed,
        encoder_weights=networks.encoder_weights,
        threads=networks.threads,
        units=checked_units(data.units),
    )
    say(f"{'SIMULATED frames' if data.data == 'simulated' else data.data}, seed {data.seed}, into {out}")
    with TrainingView() as shown:
        cards = train_all(out, settings, resume, shown)
    _print(cards, json)
    if json:
        emit_json({"out": str(out), "models": cards})


def require_training() -> None:
    """Raise `InputError` that says what to install where the extra is missing."""
    from importlib.util import find_spec

    from drivers.errors import InputError

    missing = [
        name
        for name in ("torch", "segmentation_models_pytorch", "onnx", "onnxscript")
        if find_spec(name) is None
    ]
    if missing:
        raise InputError(
            f'{", ".join(missing)} not installed: training is an extra: pip install -e ".[train]" '
            "(on a computer without GPU, install torch's CPU build first)"
        )


class TrainingView:
    """A progress bar at a terminal, a line per epoch elsewhere."""

    def __init__(self) -> None:
        from rich.progress import Progress

        from rig.live.console import PlainConsole

        self._bar = Progress(console=PlainConsole(stderr=True), transient=True)
        self._task: Any = None
        self._phase = ""

    def __enter__(self) -> Self:
        self._bar.start()
        self._task = self._bar.add_task("", total=1.0)
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, text: str, share: float) -> None:
        """Show what is done, and how far it is."""
        self._bar.update(self._task, description=text, completed=share)
        if "loss" in text:
            self._bar.console.print(text, highlight=False)
        elif text != self._phase:
            self._phase = text
            begin_phase(text)


def _print(cards: list[dict[str, Any]], to_stderr: bool) -> None:
    from rich.table import Table

    from rig.cli.fitting import table_console

    table = Table("network", "fold", "Dice", "IoU", "ms per frame", "int8 Dice", "settings")
    simulated = "SIMULATED objects" if all(card["simulated"] for card in cards) else "objects"
    table.title = f"Test {simulated} that training never saw, mean ± standard deviation"
    for card in cards:
        test, files = card["test"], card["files"]
        table.add_row(
            card["title"],
            card["fold"]["name"],
            f"{test['dice']:.3f} ± {test['dice_std']:.3f}",
            f"{test['iou']:.3f} ± {test['iou_std']:.3f}",
            f"{card['ms_per_frame']:.2f}",
            f"{files['int8']['dice']:.3f}",
            card["settings"],
        )
    table_console(to_stderr).print(table)
