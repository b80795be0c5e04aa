"""Drawn contacts as the stages of slip see them: relative differences, textures, keyframe sources."""

import cmath
import math

import cv2
import numpy as np

from rig.tactile.contact.gate import Region, find_contact
from rig.tactile.slip.height import Field
from rig.tactile.slip.keyframe import Source
from rig.tactile.slip.seen import Seen
from rig.tactile.slip.texture import FINENESS, Texture, noise_floor, structure, tensor_of

WIDTH, HEIGHT = 120, 160
"""Size of the fine copy, px; that of the work copy is half of it."""
MIDDLE_PX = complex(WIDTH / 2 - 1, HEIGHT / 2 - 1) / FINENESS
"""The point about which the drawn object turns, work pixels."""
LED_AZIMUTHS_DEG = 10.0, 130.0, 250.0
LED_GAIN, NOISE = 0.12, 0.004


def drawn(angle_deg: float, shift_px: complex = 0j, strength: float = 1.0, seed: int = 0) -> Field:
    """Return the relative difference, (h, w, 3), of a rigid dent with a hooked line on it.

    angle_deg: counter-clockwise as seen. shift_px: work pixels, y down. strength: of the line.
    """
    x, y = np.meshgrid(np.arange(WIDTH) - WIDTH / 2 + 1, HEIGHT / 2 - 1 - np.arange(HEIGHT))
    turned = (x + 1j * y - FINENESS * shift_px.conjugate()) * cmath.exp(-1j * math.radians(angle_deg))
    along, across = turned.real, turned.imag
    dent = 6.0 * np.sqrt(np.clip(1.0 - (along / 38.0) ** 2 - (across / 22.0) ** 2, 0.0, None))
    line = np.exp(-0.5 * ((across - 3.0) / 1.6) ** 2) * (np.abs(along) < 26.0)
    hook = np.exp(-0.5 * ((along - 18.0) / 1.6) ** 2) * (np.abs(across + 4.0) < 9.0)
    height = cv2.GaussianBlur(dent + 1.2 * strength * (line + hook), (0, 0), 1.0)
    down, right = np.gradient(height)
    leds = [cmath.exp(1j * math.radians(azimuth)) for azimuth in LED_AZIMUTHS_DEG]
    lit = np.stack([LED_GAIN * (right * led.real + down * led.imag) for led in leds], axis=2)
    return (lit + np.random.default_rng(seed).normal(0.0, NOISE, lit.shape)).astype(np.float32)


def work_of(fine: Field) -> Field:
    """Return the work copy of a difference."""
    return np.asarray(cv2.resize(fine, (WIDTH // 2, HEIGHT // 2), interpolation=cv2.INTER_AREA), np.float32)


def region_of(fine: Field) -> Region:
    """Return the contact in a difference."""
    region = find_contact(work_of(fine))
    assert region is not None
    return region


def texture_of(fine: Field) -> Texture:
    """Return the texture of a whole difference, with equal weight of all pixels."""
    tensor = tensor_of(np.ascontiguousarray(fine.transpose(2, 0, 1)), work_of(fine), FINENESS)
    ones = np.ones(fine.shape[:2], np.float32)
    return structure(tensor, noise_floor(tensor), ones, (0, 0, 0, 0), FINENESS)


def source_of(fine: Field) -> Source:
    """Return what a keyframe of a difference is made from."""
    return Source(work_of(fine), region_of(fine).mask, texture_of(fine))


def seen_at(time_s: float, fine: Field, torn: bool = False) -> Seen:
    """Return a difference as a frame for the tracker."""
    return Seen(work_of(fine), lambda _: texture_of(fine), region_of(fine), torn, round(1e9 * time_s))
