"""The tables of `rig benchmark segmentation`: the paper's Table II beside ours, real frames, run time."""

import json
from importlib.resources import files
from typing import Any

from rig.benchmark.estimators.tables import BenchmarkTable
from rig.benchmark.segmentation.benchmark import SegmentationReport

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
"""Castano-Amoros and Gil 2023, Table II: Dice and IoU of real frames, on the paper's own data."""
NOT_RUN = "not trained yet"


def trained_models() -> list[dict[str, Any]]:
    """Return the kept results of `rig train` (network, fold, Dice, IoU, time, settings)."""
    text = (files("rig") / "models" / "table2.json").read_text(encoding="utf-8")
    return json.loads(text)["models"]


def table_two() -> BenchmarkTable:
    """Dice, IoU and time per fold and network: kept results of `rig train --all`, and the paper's."""
    kept = {(row["title"], row["fold"]): row for row in trained_models()}
    rows = []
    for title in ("UNet++", "DeepLabV3+", "PSPNet", "ours"):
        for fold in ("D_s1", "D_s2", "D_s3"):
            row = kept.get((title, fold))
            cells = (NOT_RUN, "", "", "") if row is None else _kept_cells(row)
            rows.append((title, fold, *cells, *PAPER.get((title, fold), ("", ""))))
    return BenchmarkTable(
        "Table II: test objects of each fold, SIMULATED, units of one make; the paper's are real. "
        "ms: frame in to mask out, in the training's run",
        ("network", "fold", "Dice", "IoU", "ms", "trained (images x epochs)", "paper's Dice", "paper's IoU"),
        rows,
    )


def score_table(report: SegmentationReport) -> BenchmarkTable:
    """Dice and IoU per method and set of frames, measured now."""
    rows = [
        (
            row.method,
            row.data,
            str(row.frames),
            f"{row.dice:.3f} ± {row.dice_std:.3f}",
            f"{row.iou:.3f} ± {row.iou_std:.3f}",
        )
        for row in report.scores
    ]
    return BenchmarkTable(
        "Contacts found, shipped networks", ("method", "data", "frames", "Dice", "IoU"), rows
    )


def time_table(report: SegmentationReport) -> BenchmarkTable:
    """Run time per method, measured now on the same frames."""
    rows = [
        (
            row.method,
            "" if row.size_px is None else "{}x{}".format(*row.size_px),
            f"{row.frame_ms:.2f}",
            f"{row.frame_p99_ms:.2f}",
            "" if row.network_ms is None else f"{row.network_ms:.2f}",
        )
        for row in report.times
    ]
    columns = ("method", "looks at, px", "frame in to mask out, ms", "99 %, ms", "network alone, ms")
    return BenchmarkTable("Run time, one thread, 240 x 320 px, median, methods turn about", columns, rows)


def _kept_cells(row: dict[str, Any]) -> tuple[str, str, str, str]:
    return (
        f"{row['dice']:.3f} ± {row['dice_std']:.3f}",
        f"{row['iou']:.3f} ± {row['iou_std']:.3f}",
        f"{row['ms_per_frame']:.1f}",
        _settings(row),
    )


def _settings(row: dict[str, Any]) -> str:
    """Say how a network was trained: settings, size at which it looks, images, epochs."""
    width, height = row["size_px"]
    return f"{row['settings']}: {width}x{height} px, {row['images']['train']} x {row['epochs']}"
