"""One simulated DIGIT: renders the image of a dented gel and the ground truth of its contact.

The object's surface turns in the image, but the LEDs are fixed, so the colours of a turning contact change.
Only the simulator may read the ground truth (`touching`).
"""

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.types import Image
from fakes.gel.dots import MarkerPrint
from fakes.gel.light import Light, make_light, other_make, shade, vary_light
from fakes.gel.pad import HALF, GelPad, Imprint
from fakes.gel.variation import FAMILY, Look, Variation
from fakes.objects.surfaces import GEL_DOME_RADIUS_MM

__all__ = ["GelSensor", "Imprint"]

_MM_PER_PX = 0.060
_UNITS = 16
"""Units per grey level of the int16 sums: fine enough for noise, and fast enough for 60 Hz."""
_DRIFT_STEP_S = 0.1
_MOST_LOST = 0.85
_NOISE_FIELDS = 6
_NOISE_MARGIN_PX = 48


class GelSensor:
    """A sensor unit: its own light, scale, gel and noise, all drawn from `unit_seed`.

    Its images are 320 x 240 px, upright. variation: differences of the unit from its family. markers: whether
    dots are printed on its gel. look: of a real unit, which sets shape, scale, colours, background and noise.
    """

    def __init__(
        self, unit_seed: int, variation: Variation = FAMILY, markers: bool = False, look: Look | None = None
    ) -> None:
        rng = np.random.default_rng((unit_seed, 17))
        shape = (320, 240) if look is None else look.shape
        scale = _MM_PER_PX * 240.0 / shape[1]
        mm_per_px = (scale * float(rng.uniform(0.98, 1.0)), scale * float(rng.uniform(1.0, 1.025)))
        dome_mm = GEL_DOME_RADIUS_MM * float(rng.uniform(0.9, 1.12))
        if look is not None:
            mm_per_px, dome_mm = look.mm_per_px, look.dome_mm
        self._variation = variation
        self._pad = GelPad(shape, mm_per_px, dome_mm, variation, look)
        self._look = look
        light = vary_light(make_light(self._pad, rng), variation.light_seed)
        self._light: Light = other_make(light, variation.make_seed)
        self._noise = _noise_fields(shape, variation.noise * float(rng.uniform(1.3, 1.9)), rng)
        if look is not None:
            self._light = replace(self._light, background=look.background)
            large = shape[0] + _NOISE_MARGIN_PX, shape[1] + _NOISE_MARGIN_PX
            self._noise = np.rint(look.draw_noise(large, _NOISE_FIELDS, rng) * _UNITS).astype(np.int16)
        self._markers = MarkerPrint(shape, mm_per_px, unit_seed) if markers else None
        rows, columns = self._light.background.shape[:2]
        size = columns // HALF, rows // HALF
        half = cv2.resize(self._light.background, size, interpolation=cv2.INTER_AREA)
        self._glow = np.ascontiguousarray(half.transpose(2, 0, 1), np.float32)
        self._most_lost = np.float32(_MOST_LOST) * self._glow
        self._drifted: tuple[float, NDArray[np.int16]] | None = None
        self._changed: tuple[Imprint, NDArray[np.int16]] | None = None

    @property
    def mm_per_px(self) -> tuple[float, float]:
        """True scale along x and y in mm per pixel; on a real unit it has to be calibrated."""
        return self._pad.mm_per_px

    def render(self, imprint: Imprint | None, time_s: float, rng: np.random.Generator) -> Image:
        """Return the frame (H, W, 3) uint8 RGB of an imprint (None: no contact), without JPEG.

        time_s: time for the slow drift of the light. rng: draws the noise of this frame.
        """
        frame = self._lit_background(time_s).copy()
        if imprint is not None:
            if self._changed is None or self._changed[0] != imprint:  # a still object makes equal imprints
                self._changed = imprint, self._change(imprint)
            cv2.add(frame, self._changed[1], dst=frame)
        if self._markers is not None:
            shear = None if imprint is None else imprint.shear
            touching = None if imprint is None or shear is None else self._pad.touching(imprint)
            frame = (frame * self._markers.light_left(shear, touching)).astype(np.int16)
        self._add_noise(frame, rng)
        np.right_shift(frame, 4, out=frame)
        np.clip(frame, 0, 255, out=frame)
        return frame.astype(np.uint8)

    def touching(self, imprint: Imprint | None) -> NDArray[np.uint8]:
        """Return the geometric contact as (H, W) uint8, 255 where object and gel touch, else 0."""
        if imprint is None:
            return np.zeros(self._pad.shape, np.uint8)
        return self._pad.touching(imprint).astype(np.uint8) * np.uint8(255)

    def change(self, imprint: Imprint) -> NDArray[np.float32]:
        """Return the change by an imprint, (H, W, 3) in grey levels, without noise and drift of the light."""
        return self._change(imprint).astype(np.float32) / np.float32(_UNITS)

    def _change(self, imprint: Imprint) -> NDArray[np.int16]:
        """Return the change by a dent, in units of a sixteenth grey level."""
        dent = self._pad.dent(imprint)
        if self._look is not None:
            return self._full_size(self._look.change(dent) * np.float32(_UNITS))
        light = self._light
        knee = np.float32(1.0 / (8.0 * self._variation.slope_at_knee * HALF))
        slope_x = cv2.Sobel(dent, cv2.CV_32F, 1, 0, scale=float(knee / self._pad.mm_per_px[0]))
        slope_y = cv2.Sobel(dent, cv2.CV_32F, 0, 1, scale=float(knee / self._pad.mm_per_px[1]))
        # In place: arrays of this size are slow to allocate.
        facing, other = light.towards_x * slope_x, light.towards_y * slope_y
        facing += other
        # a slope that falls in the light's direction brightens, with saturation
        np.multiply(facing, facing, out=other)
        other += np.float32(1.0)
        facing /= np.sqrt(other, out=other)
        facing *= light.gain
        lost = shade(dent, light, self._variation, HALF * self._pad.mm_per_px[0])
        lost *= self._glow
        facing += lost
        np.minimum(facing, self._most_lost, out=facing)
        facing *= np.float32(-_UNITS)
        return self._full_size(np.asarray(cv2.merge(list(facing)), np.float32))

    def _full_size(self, change: NDArray[np.float32]) -> NDArray[np.int16]:
        """Upsample a change (h, w, 3) to the image's resolution, in integer units."""
        return np.asarray(cv2.resize(change.astype(np.int16), self._pad.shape[::-1]), np.int16)

    def _lit_background(self, time_s: float) -> NDArray[np.int16]:
        """Return the background at a time. Its slow drift is updated every tenth of a second."""
        step = np.floor(time_s / _DRIFT_STEP_S) * _DRIFT_STEP_S
        if self._drifted is None or self._drifted[0] != step:
            factor = (self._light.drift_at(step) * _UNITS).astype(np.float32)
            lit = self._light.background * factor + np.float32(_UNITS / 2)
            self._drifted = step, lit.astype(np.int16)
        return self._drifted[1]

    def _add_noise(self, frame: NDArray[np.int16], rng: np.random.Generator) -> None:
        rows, columns = self._pad.shape
        which, down, across, sign = rng.integers(0, (_NOISE_FIELDS, _NOISE_MARGIN_PX, _NOISE_MARGIN_PX, 2))
        if self._look is not None:  # a camera's noise differs between odd and even pixels
            down, across = down - down % 2, across - across % 2
        field = self._noise[which][down : down + rows, across : across + columns]
        (cv2.add if sign else cv2.subtract)(frame, field, dst=frame)


def _noise_fields(shape: tuple[int, int], sigma: float, rng: np.random.Generator) -> NDArray[np.int16]:
    """Return read-out noise in sixteenths of a grey level, correlated between pixels and within columns."""
    rows, columns = shape[0] + _NOISE_MARGIN_PX, shape[1] + _NOISE_MARGIN_PX
    fields = []
    for _ in range(_NOISE_FIELDS):
        noise = cv2.GaussianBlur(rng.standard_normal((rows, columns, 3)).astype(np.float32), (0, 0), 0.6)
        noise *= np.array([1.1, 0.8, 1.1], np.float32) * np.float32(sigma) / noise.std()
        noise += rng.normal(0.0, 0.25, (1, columns, 1))
        fields.append(np.rint(noise * _UNITS).astype(np.int16))
    return np.stack(fields)
