"""What tests share: where real data lies, and a tactile sensor drawn by a few lines."""

import gc
import math
import os

# As the command line does: BLAS threads that wait for one another make a busy computer ten times slower.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import settings
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Press = Callable[..., Image]

# How long an example takes says nothing about it: machines are shared.
settings.register_profile("rig", deadline=None)
settings.load_profile("rig")

ROOT = Path(__file__).parent.parent


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("hardware")
    group.addoption("--bench", metavar="FILE", help="bench file of real hardware for the contract suite")
    group.addoption("--moves", action="store_true", help="let the contract suite move that hardware")


@pytest.fixture(scope="session", autouse=True)
def _own_memory(tmp_path_factory: pytest.TempPathFactory) -> None:
    """What is remembered of hands is that of these tests, not of the benches that this computer drives."""
    os.environ["XDG_STATE_HOME"] = str(tmp_path_factory.mktemp("state"))


def pytest_collection_finish() -> None:
    """Leave what collecting made out of every later garbage collection.

    All threads of this process, simulated devices among them, stand still while it runs: for 0.15 s
    and more with the whole suite collected, long enough to miss what a device promises.
    """
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session")
def real_data() -> Path:
    """The folder of real recordings: RIG_TEST_DATA, by default ../shared/data beside the project."""
    folder = Path(os.environ.get("RIG_TEST_DATA", ROOT.parent / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip(f"no real data at {folder}: set RIG_TEST_DATA")
    return folder


def ellipse_mask(
    angle_deg: float,
    half_axes: tuple[float, float] = (85.0, 35.0),
    center: tuple[float, float] = (120.0, 160.0),
    size: tuple[int, int] = (240, 320),
) -> Image:
    """A filled ellipse, width x height `size`; the angle is counter-clockwise as seen."""
    mask = np.zeros((size[1], size[0]), np.uint8)
    axes = (2 * half_axes[0], 2 * half_axes[1])
    cv2.ellipse(mask, (center, axes, -angle_deg), 255, -1)
    return mask


def _background(size: tuple[int, int]) -> NDArray[np.float64]:
    x, y = np.meshgrid(np.linspace(0, 1, size[0]), np.linspace(0, 1, size[1]))
    return np.stack([170 - 130 * x, 40 + 110 * y * x + 30 * x, 50 + 70 * (1 - y)], axis=2)


def _press(
    angle_deg: float | None = 0.0,
    half_axes: tuple[float, float] = (85.0, 35.0),
    center: tuple[float, float] = (120.0, 160.0),
    size: tuple[int, int] = (240, 320),
    light: tuple[float, float, float] = (1.0, 1.0, 1.0),
    strength: float = 1.0,
    noise: float = 1.5,
    seed: int = 0,
) -> Image:
    lit = _background(size)
    if angle_deg is not None:
        turn = math.radians(angle_deg)
        x, y = np.meshgrid(np.arange(size[0]) - center[0], center[1] - np.arange(size[1]))
        along, across = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
        reach = np.clip(1.0 - (along / half_axes[0]) ** 2 - (across / half_axes[1]) ** 2, 0.0, None)
        depth = cv2.GaussianBlur(np.sqrt(reach) * min(half_axes), (0, 0), 3.0)
        slope_y, slope_x = np.gradient(depth)
        # Three lamps around the gel, as a DIGIT's: each brightens the flanks that face it.
        sides = np.stack([slope_x, -0.5 * slope_x + 0.9 * slope_y, -0.5 * slope_x - 0.9 * slope_y], axis=2)
        lit = lit * (1.0 + strength * 0.6 * sides)
    dirt = np.random.default_rng(seed).normal(0.0, noise, lit.shape) if noise else 0.0
    return np.clip(np.rint(lit * np.asarray(light) + dirt), 0, 255).astype(np.uint8)


@pytest.fixture(scope="session")
def press() -> Press:
    """Draws a frame: `press(angle_deg or None, half_axes, center, size, light, strength, noise, seed)`."""
    return _press


@pytest.fixture(scope="session")
def blank() -> Image:
    """The drawn sensor's frame without contact, 240 x 320."""
    return _press(None, noise=0.0)


@pytest.fixture(scope="session")
def drawn_mask() -> Press:
    """Draws a mask: `drawn_mask(angle_deg, half_axes, center, size)`."""
    return ellipse_mask
