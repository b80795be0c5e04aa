"""Textures of simulated surfaces: small heights added to a shape, in mm."""

from collections.abc import Callable

import cv2
import numpy as np

from fakes.objects.shapes import ContactShape, Field

Texture = Callable[[Field, Field, float, np.random.Generator], Field]
"""(along_mm, across_mm, pitch_mm, rng) to a height between 0 and 1."""


def texture_height(contact: ContactShape, x_mm: Field, z_mm: Field, rng: np.random.Generator) -> Field:
    """Return the texture of a contact in mm over object coordinates in mm; its phase comes from `rng`."""
    if contact.texture == "none" or contact.texture_mm == 0.0:
        return np.zeros_like(x_mm)
    axis = np.deg2rad(contact.texture_deg)
    cos, sin = np.float32(np.cos(axis)), np.float32(np.sin(axis))
    along, across = cos * x_mm - sin * z_mm, sin * x_mm + cos * z_mm
    relief = TEXTURES[contact.texture](along, across, contact.pitch_mm, rng)
    return (np.float32(contact.texture_mm) * relief).astype(np.float32)


def _wave(distance: Field, pitch_mm: float, rng: np.random.Generator) -> Field:
    phase = rng.uniform(0.0, 2.0 * np.pi)
    return (0.5 + 0.5 * np.sin(distance * np.float32(2 * np.pi / pitch_mm) + np.float32(phase))).astype(
        np.float32
    )


def _ribs(along: Field, across: Field, pitch_mm: float, rng: np.random.Generator) -> Field:
    return _wave(along, pitch_mm, rng)


def _knurl(along: Field, across: Field, pitch_mm: float, rng: np.random.Generator) -> Field:
    return np.maximum(_wave(along + across, pitch_mm, rng), _wave(along - across, pitch_mm, rng))


def _grain(along: Field, across: Field, pitch_mm: float, rng: np.random.Generator) -> Field:
    """Wood: fine lines along the axis that wander and break off."""
    return _noise(along, across, (8.0 * pitch_mm, pitch_mm), rng)


def _leather(along: Field, across: Field, pitch_mm: float, rng: np.random.Generator) -> Field:
    return _noise(along, across, (pitch_mm, pitch_mm), rng)


def _fabric(along: Field, across: Field, pitch_mm: float, rng: np.random.Generator) -> Field:
    weave = _wave(along, pitch_mm, rng) * _wave(across, pitch_mm, rng)
    return (0.6 * weave + 0.4 * _noise(along, across, (2.0, 2.0), rng)).astype(np.float32)


def _letters(along: Field, across: Field, pitch_mm: float, rng: np.random.Generator) -> Field:
    """Embossed strokes in two lines of writing; the closest points are the strokes."""
    canvas = np.ones((256, 256), np.float32)
    height_px = max(int(256 * pitch_mm / 30.0), 4)
    for row in (128 - height_px, 128 + height_px // 2):
        for column in range(10, 240, int(0.8 * height_px) + 1):
            ends = rng.integers(0, height_px, (2, 4)) * np.array([0.6, 1.0, 0.6, 1.0])
            for x0, y0, x1, y1 in ends.astype(int):
                cv2.line(canvas, (column + x0, row + y0), (column + x1, row + y1), 0.0, 2)
    return _sampled(np.asarray(cv2.GaussianBlur(canvas, (0, 0), 1.0), np.float32), along, across)


def _noise(along: Field, across: Field, scale_mm: tuple[float, float], rng: np.random.Generator) -> Field:
    """Smooth noise of the given feature sizes along and across, between 0 and 1."""
    field = rng.standard_normal((256, 256)).astype(np.float32)
    sigma_px = [max(0.25 * size * 256 / 30.0, 0.5) for size in scale_mm]
    field = cv2.GaussianBlur(field, (0, 0), sigmaX=sigma_px[0], sigmaY=sigma_px[1])
    low, high = np.percentile(field, (2.0, 98.0))
    return _sampled(np.clip((field - low) / (high - low), 0.0, 1.0).astype(np.float32), along, across)


def _sampled(canvas: Field, along: Field, across: Field) -> Field:
    """Read a 30 mm square canvas at coordinates in mm, repeating mirrored beyond it."""
    scale, centre = canvas.shape[0] / 30.0, canvas.shape[0] / 2
    columns = (along * scale + centre).astype(np.float32)
    rows = (across * scale + centre).astype(np.float32)
    sampled = cv2.remap(canvas, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(sampled, np.float32)


TEXTURES: dict[str, Texture] = {
    "ribs": _ribs,
    "knurl": _knurl,
    "grain": _grain,
    "leather": _leather,
    "fabric": _fabric,
    "letters": _letters,
}
"""Textures by the name that the catalogue uses ("none" is a smooth surface)."""
