"""Light of sensors of other makes: colours from other sides, another glow, weaker lamps."""

from dataclasses import replace

import cv2
import numpy as np

from fakes.gel.light import Light, Planes

_SIDES_RAD = np.pi / 2.0


def other_make(light: Light, make_seed: int | None) -> Light:
    """Return the light of another make; the same one for None."""
    if make_seed is None:
        return light
    rng = np.random.default_rng((make_seed, 53))
    order = rng.permutation(3)
    turn = float(rng.integers(4)) * _SIDES_RAD + float(rng.normal(0.0, 0.25))
    cos, sin = np.float32(np.cos(turn)), np.float32(np.sin(turn))
    x, y = light.towards_x[order], light.towards_y[order]
    towards_x, towards_y = cos * x + sin * y, cos * y - sin * x
    background = _glow(light.background, (towards_x, towards_y), rng)
    gain = light.gain[order] * np.float32(rng.uniform(0.4, 0.85))
    return replace(light, background=background, towards_x=towards_x, towards_y=towards_y, gain=gain)


def _glow(family: Planes, towards: tuple[Planes, Planes], rng: np.random.Generator) -> Planes:
    """A glow that is brightest in the middle and tinted from the side of each lamp; some of the family's."""
    rows, columns = family.shape[:2]
    v, u = np.mgrid[0:rows, 0:columns].astype(np.float32)
    u, v = (u + 0.5) / columns - 0.5, (v + 0.5) / rows - 0.5
    wide = np.exp(-((u / rng.uniform(0.45, 0.9)) ** 2) - (v / rng.uniform(0.45, 0.9)) ** 2)
    level, dark = rng.uniform(70.0, 150.0), rng.uniform(0.25, 0.6)
    planes = []
    for x, y in zip(*towards, strict=True):
        side = u * np.float32(-x.mean()) + v * np.float32(-y.mean())
        planes.append(level * rng.uniform(0.7, 1.2) * (dark + (1.0 - dark) * wide) * (1.0 + 0.7 * side))
    share = np.float32(rng.uniform(0.0, 0.5))
    smooth = cv2.merge([np.asarray(plane, np.float32) for plane in planes])
    mixed = (1.0 - share) * smooth + share * family * np.float32(smooth.mean() / family.mean())
    return np.clip(mixed, 6.0, 245.0).astype(np.float32)
