"""A simulated DIGIT or camera as it appears on its wire: modes, light, numbers, and faults.

It replaces the device and its driver in the kernel: raw images on a schedule, each with a number and a
capture time. Those of a DIGIT are rotated by 90 degrees, and its first ones are green.
"""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np

from drivers.clock import NS_PER_S, Clock
from drivers.errors import InputError
from drivers.types import Image
from fakes.faults import Faults

Kind = Literal["digit", "camera"]
Render = Callable[[int], Image]
OnLight = Callable[[float, float, float], None]

FAULTS = {
    kind: {"frames": None} for kind in ("freeze", "drop", "disconnect", "green", "shift", "truncate", "slow")
}
"""Kinds of fault; each takes the number of images after which it ends."""
DIGIT_MODES = {(320, 240): (30.0, 60.0), (640, 480): (15.0, 30.0)}
"""Rates in Hz by raw size in px; a change of size resets the rate to the first."""
GREEN_AFTER_OPENING = 3
JPEG_QUALITY = 95
_EMPTY_BUFFER_RGB = (0, 135, 0)
"""The colour that a YUV buffer of zeros decodes to (ITU-R BT.601)."""
_SHIFT_PX = 37
_CUT_AT = 0.6
_SLOWER = 2


@dataclass(frozen=True, slots=True)
class Capture:
    """One image on the wire. time_ns: capture time on the sensor's clock."""

    number: int
    time_ns: int
    jpeg: bytes


class MjpegSensor:
    """The state of one sensor. `render(time_ns)` draws (H, W, 3) uint8 RGB, upright.

    rate_hz: the initial rate. on_light: is called with the intensities of the LEDs, 0 to 1. phase: time of
    the capture within a period, 0 to 1, so that sensors do not all capture at once. Several threads may use a
    sensor. Raises `InputError` for a rate that a DIGIT does not have.
    """

    def __init__(
        self,
        render: Render,
        rate_hz: float,
        clock: Clock,
        kind: Kind,
        on_light: OnLight | None = None,
        phase: float = 0.0,
    ) -> None:
        self._render, self._clock = render, clock
        self._kind: Kind = kind
        self._on_light, self._phase = on_light, phase
        self._lock = threading.RLock()
        height, width = render(clock.now_ns()).shape[:2]
        self._size = (height, width) if kind == "digit" else (width, height)
        self._rates = DIGIT_MODES if kind == "digit" else {self._size: (rate_hz,)}
        self._rate_hz = rate_hz
        self._faults = Faults("simulated sensor", FAULTS, clock.now_ns)
        self._last: bytes | None = None
        self._greens = 0
        self._number, self._due_ns = 0, clock.now_ns()
        self._set_rate(rate_hz)

    def open(self) -> None:
        """Start the device for the first client, with empty images at first."""
        with self._lock:
            self._skip_until(self._clock.now_ns())
            self._greens = GREEN_AFTER_OPENING if self._kind == "digit" else 0

    def configure(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Set `size_px` [w, h] (raw), `rate_hz`, `light` [r, g, b]; return the present settings.

        Raises `InputError` for a setting that the device does not offer.
        """
        unknown = set(settings) - {"size_px", "rate_hz", "light"}
        if unknown:
            raise InputError(f"sensor: no settings {sorted(unknown)}; there are size_px, rate_hz, light")
        with self._lock:
            if "size_px" in settings:
                size = _numbers(settings["size_px"], 2)
                wanted = next((known for known in self._rates if known == size), None)
                if wanted is None:
                    raise InputError(f"sensor: no size {size}; there are {sorted(self._rates)}")
                self._size = wanted
                self._set_rate(self._rates[wanted][0])
            if "rate_hz" in settings:
                self._set_rate(_numbers([settings["rate_hz"]], 1)[0])
            if "light" in settings:
                light = _numbers(settings["light"], 3)
                if not all(0.0 <= value <= 1.0 for value in light):
                    raise InputError(f"sensor: light {light}: give each colour from 0 to 1")
                if self._on_light is not None:
                    self._on_light(light[0], light[1], light[2])
            return {"size_px": list(self._size), "rate_hz": self._rate_hz}

    def inject(self, kind: str, **arguments: Any) -> None:
        """Start a fault of `FAULTS`, or end all with "clear". Raises `InputError` for an unknown one."""
        if kind == "clear":
            self._faults.clear()
        else:
            self._faults.begin(kind, arguments)

    def active(self, kind: str) -> bool:
        fault = self._faults.get(kind)
        return fault is not None and fault["frames"] != 0

    def due_ns(self, patience_ns: int) -> tuple[int, int]:
        """Return the capture time of the next image, and how many were discarded before it.

        If an image has not been captured for `patience_ns`, it is discarded with all that were due since, so
        that the next one is fresh.
        """
        with self._lock:
            now = self._clock.now_ns()
            missed = self._skip_until(now) if now - self._due_ns > patience_ns else 0
            return self._due_ns, missed

    def capture(self) -> Capture | None:
        """Capture the image that is due; return None if it never reaches the wire."""
        with self._lock:
            number, time_ns, size = self._number, self._due_ns, self._size
            self._number += 1
            slower = _SLOWER if self._hits("slow") else 1
            self._due_ns += slower * round(NS_PER_S / self._rate_hz)
            if self._hits("drop"):
                return None
            frozen = self._last if self._hits("freeze") else None
            empty = self._hits("green") or self._greens > 0
            self._greens = max(self._greens - 1, 0)
            shift, cut = self._hits("shift"), self._hits("truncate")
        if frozen is None:
            frozen = self._last = _encoded(_empty(size) if empty else self._raw(time_ns, size, shift))
        return Capture(number, time_ns, frozen[: int(len(frozen) * _CUT_AT)] if cut else frozen)

    def _skip_until(self, time_ns: int) -> int:
        """Skip the images up to a time; return how many they were."""
        period_ns = round(NS_PER_S / self._rate_hz)
        passed = max(-((self._due_ns - time_ns) // period_ns), 0)
        self._number += passed
        self._due_ns += passed * period_ns
        return passed

    def _hits(self, kind: str) -> bool:
        """Whether a fault is active for this image; count the image."""
        fault = self._faults.get(kind)
        if fault is None or fault["frames"] == 0:
            return False
        if fault["frames"] is not None:
            fault["frames"] -= 1
        return True

    def _raw(self, time_ns: int, size: tuple[int, int], shift: bool) -> Image:
        image = self._render(time_ns)
        if self._kind == "digit":
            image = np.asarray(cv2.rotate(image, cv2.ROTATE_90_CLOCKWISE), np.uint8)
        if image.shape[1::-1] != size:
            image = np.asarray(cv2.resize(image, size), np.uint8)
        return np.roll(image, _SHIFT_PX, axis=1) if shift else image

    def _set_rate(self, rate_hz: float) -> None:
        if rate_hz not in self._rates[self._size]:
            raise InputError(f"sensor: no rate {rate_hz:g} Hz at {self._size}; {self._rates[self._size]}")
        # images of the old rate that were not captured are numbered before the new rate begins
        self._skip_until(self._clock.now_ns())
        self._rate_hz = rate_hz
        period_ns = round(NS_PER_S / rate_hz)
        self._due_ns = round(self._phase * period_ns) + period_ns * -(-self._clock.now_ns() // period_ns)


def _numbers(value: Any, count: int) -> tuple[float, ...]:
    if not isinstance(value, list) or len(value) != count or not all(type(v) in (int, float) for v in value):
        raise InputError(f"sensor: {value!r}: give {count} number{'s' * (count > 1)}")
    return tuple(float(v) for v in value)


def _empty(size: tuple[int, int]) -> Image:
    return np.full((size[1], size[0], 3), _EMPTY_BUFFER_RGB, np.uint8)


def _encoded(image: Image) -> bytes:
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    return cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)[1].tobytes()
