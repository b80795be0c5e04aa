"""Settings of a training: data, networks, folds, and the reduced or the paper's parameters."""

from dataclasses import dataclass
from pathlib import Path

from calibration.gel.look import GelLook, load_look
from drivers.errors import unknown_name
from rig.labels.datasets import Fold
from rig.training.loop import Schedule
from rig.training.networks import OURS, Architecture

SIMULATED = "simulated"
"""Value of `data` for frames that are rendered for this training."""
VARIED, FAMILY = "varied", "family"
UNITS = (VARIED, FAMILY)
"""Kinds of simulated sensors. `varied`: many makes; the network generalises to unseen makes. `family`: one
make, as on a bench and in the paper's data set. Instead, the file of a real unit's look can be given: sensors
are then of varied makes, and every second one is a variation of that look."""
LOOK_SUFFIX = ".npz"


@dataclass(frozen=True, slots=True)
class TrainSettings:
    """Settings of a training.

    data: a folder, or `SIMULATED`. images: simulated training frames per fold. paper: the paper's
    parameters (256 x 320 px, 30 epochs, batch 32) instead of the reduced ones. encoder_weights: a file.
    threads: of torch, None for its default. units: the simulated sensors, see `UNITS`.
    """

    data: str
    architectures: tuple[Architecture, ...]
    folds: tuple[Fold, ...]
    encoder: str
    images: int
    epochs: int
    paper: bool
    seed: int
    encoder_weights: Path | None = None
    threads: int | None = None
    units: str = VARIED

    @property
    def look(self) -> GelLook | None:
        """The real unit's look whose variations are among the simulated sensors; None without one."""
        return load_look(Path(self.units)) if self.units.endswith(LOOK_SUFFIX) else None

    def size(self, architecture: Architecture) -> tuple[int, int]:
        """(height, width) of a network's input in px."""
        return architecture.paper_size if self.paper else architecture.size

    @property
    def frame_size(self) -> tuple[int, int]:
        """(width, height) of the stored frames in px."""
        return (256, 320) if self.paper else (128, 160)

    def schedule(self, architecture: Architecture) -> Schedule:
        """The paper's batch and rate for its networks; a one-cycle rate for ours."""
        if architecture.name == OURS:
            return Schedule(self.epochs, 32, 4e-3, True)
        return Schedule(self.epochs, 32, 1e-4, False) if self.paper else Schedule(self.epochs, 16, 1e-3, True)


def checked_units(name: str) -> str:
    """Return `name` if it is a kind of units or the file of a look (.npz). Raises `RigError` otherwise."""
    if name.endswith(LOOK_SUFFIX):
        load_look(Path(name))
    elif name not in UNITS:
        raise unknown_name("kind of simulated sensors", name, UNITS)
    return name
