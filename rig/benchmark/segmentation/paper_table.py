"""Make the paper's Table II: stored results of trained networks beside those of the paper."""

import json
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

from rig.benchmark.harness import Table, column, table_of

NETWORKS = {"deeplabv3plus": "DeepLabV3+", "unetplusplus": "UNet++", "pspnet": "PSPNet"}
"""The paper's networks by their names in `rig train`, in the order of the paper."""
OURS = "ours"
PAPER = {
    ("UNet++", "D_s1"): ("0.950 ± 0.018", "0.906 ± 0.033"),
    ("UNet++", "D_s2"): ("0.955 ± 0.008", "0.915 ± 0.015"),
    ("UNet++", "D_s3"): ("0.969 ± 0.006", "0.940 ± 0.011"),
    ("DeepLabV3+", "D_s1"): ("0.947 ± 0.020", "0.899 ± 0.036"),
    ("DeepLabV3+", "D_s2"): ("0.951 ± 0.012", "0.906 ± 0.021"),
    ("DeepLabV3+", "D_s3"): ("0.969 ± 0.007", "0.937 ± 0.013"),
    ("PSPNet", "D_s1"): ("0.937 ± 0.026", "0.883 ± 0.045"),
    ("PSPNet", "D_s2"): ("0.953 ± 0.009", "0.910 ± 0.017"),
    ("PSPNet", "D_s3"): ("0.963 ± 0.008", "0.929 ± 0.014"),
}
"""Castano-Amoros and Gil 2023, Table II: Dice and IoU on the paper's own real frames."""


@dataclass(frozen=True, slots=True)
class MeanStd:
    """Mean and standard deviation over frames."""

    mean: float
    std: float

    def __str__(self) -> str:
        return f"{self.mean:.3f} ± {self.std:.3f}"


@dataclass(frozen=True, slots=True)
class TrainedRow:
    """Results of a network trained on one fold, and those of the paper."""

    network: str = column("network")
    fold: str = column("fold")
    dice: MeanStd | None = column("Dice", lambda dice: "not trained yet" if dice is None else str(dice))
    iou: MeanStd | None = column("IoU")
    ms: float | None = column("ms", ".1f", "frame in to mask out, in the training's run")
    trained: str | None = column("trained (images x epochs)", doc="settings, size of the network's input")
    paper_dice: str | None = column("paper's Dice")
    paper_iou: str | None = column("paper's IoU")


def trained_models() -> list[dict[str, Any]]:
    """Return the stored results of `rig train` (network, fold, Dice, IoU, time, settings)."""
    text = (files("rig") / "models" / "table2.json").read_text(encoding="utf-8")
    return json.loads(text)["models"]


def table_two() -> Table:
    """Return the stored results of `rig train --all` beside the paper's, by network and fold."""
    kept = {(row["title"], row["fold"]): row for row in trained_models()}
    title = "Table II: test objects of each fold, SIMULATED, units of one make; the paper's are real. "
    title += "ms: frame in to mask out, in the training's run"
    networks = ("UNet++", "DeepLabV3+", "PSPNet", OURS)
    keys = [(network, fold) for network in networks for fold in ("D_s1", "D_s2", "D_s3")]
    return table_of(title, TrainedRow, [_trained_row(key, kept.get(key)) for key in keys], left=2)


def _trained_row(key: tuple[str, str], kept: dict[str, Any] | None) -> TrainedRow:
    paper = PAPER.get(key, (None, None))
    if kept is None:
        return TrainedRow(*key, None, None, None, None, *paper)
    size = "{}x{} px".format(*kept["size_px"])
    return TrainedRow(
        *key,
        MeanStd(kept["dice"], kept["dice_std"]),
        MeanStd(kept["iou"], kept["iou_std"]),
        kept["ms_per_frame"],
        f"{kept['settings']}: {size}, {kept['images']['train']} x {kept['epochs']}",
        *paper,
    )
