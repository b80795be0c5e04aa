"""A tactile sensor drawn by a few lines, for tests that need a contact of a known angle and nothing more."""

import math
from collections.abc import Callable
from functools import lru_cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Press = Callable[..., Image]
SPECKS = ((70, 120), (130, 200), (170, 130))
"""Places of the specks that `specked` draws, px."""


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


def drawn_press(
    angle_deg: float | None = 0.0,
    half_axes: tuple[float, float] = (85.0, 35.0),
    center: tuple[float, float] = (120.0, 160.0),
    size: tuple[int, int] = (240, 320),
    light: tuple[float, float, float] = (1.0, 1.0, 1.0),
    strength: float = 1.0,
    noise: float = 1.5,
    seed: int = 0,
) -> Image:
    """A frame, (H, W, 3) uint8 RGB, with an ellipsoid pressed into the gel; with None nothing is."""
    return _press(angle_deg, half_axes, center, size, light, strength, noise, seed).copy()


def specked(image: Image, strength: float) -> Image:
    """A frame, (H, W, 3) uint8 RGB, of a gel with three dark specks; they are seen better under a contact."""
    light = np.ones(image.shape[:2], np.float32)
    for place in SPECKS:
        cv2.circle(light, place, 3, 1.0 - strength, -1)
    soft = np.asarray(cv2.GaussianBlur(light, (0, 0), 0.8), np.float32)
    return np.clip(image * soft[..., None], 0, 255).astype(np.uint8)


@lru_cache(maxsize=128)
def _press(
    angle_deg: float | None,
    half_axes: tuple[float, float],
    center: tuple[float, float],
    size: tuple[int, int],
    light: tuple[float, float, float],
    strength: float,
    noise: float,
    seed: int,
) -> Image:
    lit = _background(size)
    if angle_deg is not None:
        slope_x, slope_y = _slopes(angle_deg, half_axes, center, size)
        # Three lamps around the gel, as a DIGIT's: each brightens the flanks that face it.
        sides = (slope_x, -0.5 * slope_x + 0.9 * slope_y, -0.5 * slope_x - 0.9 * slope_y)
        lit = lit * (1.0 + strength * 0.6 * np.stack(sides))
    planes = np.rint(lit * np.reshape(light, (3, 1, 1)) + noise * _dirt(seed, size))
    return np.ascontiguousarray(np.clip(planes, 0, 255).astype(np.uint8).transpose(1, 2, 0))


def _slopes(
    angle_deg: float, half_axes: tuple[float, float], center: tuple[float, float], size: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    turn = math.radians(angle_deg)
    x, y = np.meshgrid(np.arange(size[0]) - center[0], center[1] - np.arange(size[1]))
    along, across = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
    reach = np.clip(1.0 - (along / half_axes[0]) ** 2 - (across / half_axes[1]) ** 2, 0.0, None)
    depth = cv2.GaussianBlur(np.sqrt(reach) * min(half_axes), (0, 0), 3.0)
    slope_y, slope_x = np.gradient(depth)
    return slope_x, slope_y


@lru_cache(maxsize=4)
def _background(size: tuple[int, int]) -> NDArray[np.float64]:
    """Light over the gel without contact, (3, H, W)."""
    x, y = np.meshgrid(np.linspace(0, 1, size[0]), np.linspace(0, 1, size[1]))
    return np.stack([170 - 130 * x, 40 + 110 * y * x + 30 * x, 50 + 70 * (1 - y)])


@lru_cache(maxsize=32)
def _dirt(seed: int, size: tuple[int, int]) -> NDArray[np.float64]:
    """Noise of a frame, (3, H, W), its standard deviation 1."""
    noise = np.random.default_rng(seed).normal(0.0, 1.0, (size[1], size[0], 3))
    return np.ascontiguousarray(noise.transpose(2, 0, 1))


@pytest.fixture(scope="session")
def press() -> Press:
    """Draws a frame: `press(angle_deg or None, half_axes, center, size, light, strength, noise, seed)`."""
    return drawn_press


@pytest.fixture(scope="session")
def blank() -> Image:
    """The drawn sensor's frame without contact, 240 x 320."""
    return drawn_press(None, noise=0.0)


@pytest.fixture(scope="session")
def drawn_mask() -> Press:
    """Draws a mask: `drawn_mask(angle_deg, half_axes, center, size)`."""
    return ellipse_mask
