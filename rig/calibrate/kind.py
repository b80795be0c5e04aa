"""A kind of calibration, and the options that the commands of several kinds have."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

import numpy as np
import typer

from rig.calibrate.bench import Station
from rig.calibrate.result import CalibrationResult
from rig.config import BenchConfig

Options = TypeVar("Options")
Differences = dict[str, float | None]
TargetOption = Annotated[
    str,
    typer.Option(
        "--target",
        help="Target (squares, sizes in mm, ArUco dictionary): charuco:8x6:25:18:DICT_5X5_100 (append "
        ":legacy for the pattern of OpenCV before 4.6), chessboard:9x6:25[:px] or marker:60:DICT_4X4_50:0.",
    ),
]
CameraFile = Annotated[Path | None, typer.Option("--camera", help="Camera file of the rig, ROS or OpenCV.")]
PicturesOption = Annotated[
    str, typer.Option("--pictures", help="With --from: pattern of the picture files, as 'left*.jpg'.")
]
PosesOption = Annotated[int, typer.Option("--poses", min=5, max=60, help="On a bench: number of poses.")]
SerialOption = Annotated[str, typer.Option("--serial", help="With --from: serial of the calibrated device.")]
ObjectsFolder = Annotated[
    Path | None,
    typer.Option("--objects", help="Folder of your own objects. Default: objects/ beside the bench file."),
]


@dataclass(frozen=True, slots=True)
class Samples:
    """The folder of recorded samples. bench: on which they were taken; None if none was named."""

    folder: Path
    bench: BenchConfig | None = None


@dataclass(frozen=True, slots=True)
class Kind(Generic[Options]):
    """A kind of calibration and its command `rig calibrate NAME`.

    name: in files and commands. options: dataclass of the command's own options; its docstring is the help.
    counted: name of the samples on the watch page, as "views". solve: reads recorded samples, solves and
    assesses them, and draws the figures of the page; returns several results for several devices. collect:
    takes the samples on a bench, then solves them. compare: returns how far two files differ, in px over
    the picture or in mm; None if only their pages can be compared.
    """

    name: str
    options: type[Options]
    counted: str
    solve: Callable[[Samples, Options], CalibrationResult | list[CalibrationResult]]
    collect: Callable[[Station, Options], list[CalibrationResult]]
    compare: Callable[[Path, Path], Differences] | None = None


def distance_mm(one: Mapping[str, Any], other: Mapping[str, Any]) -> float:
    """Return the distance between the translations of two files' contents, mm."""
    apart = np.subtract(one["translation_m"], other["translation_m"])
    return round(1e3 * float(np.linalg.norm(apart)), 3)
