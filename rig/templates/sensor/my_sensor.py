"""A template for a tactile sensor: replace the simulation in `MyStream`, which opens and reads it."""

import numpy as np

from drivers.clock import NS_PER_S, Clock
from drivers.interfaces import TactileSensor
from drivers.video.decode import decode_frame
from drivers.video.reader import FrameReader
from drivers.video.stream import FrameStream, RawFrame


class MyStream(FrameStream):
    """The opened device; one thread reads it. It is reopened after each `DeviceError` raised here."""

    warm_up = 0  # images to discard while exposure settles
    stamp = "peer"  # source of the capture times: "kernel", or the device, "peer"
    ends = False

    def __init__(self, rate_hz: float, size_px: tuple[int, int], clock: Clock, grey: int) -> None:
        """Open it. If that fails, raise `drivers.errors.DeviceError` with advice."""
        self._clock, self._period_ns, self._grey = clock, NS_PER_S / rate_hz, grey
        self._shape = (size_px[1], size_px[0], 3)
        self._start_ns, self._number = clock.now_ns(), 0

    def read(self) -> RawFrame:
        """Wait for the next image, (H, W, 3) uint8 RGB, or its JPEG bytes as `encoded`."""
        self._number += 1
        taken_ns = self._start_ns + round(self._number * self._period_ns)
        self._clock.sleep_until(taken_ns)
        noise = np.random.default_rng(self._number).integers(-3, 4, self._shape)
        image = (self._grey + noise).astype(np.uint8)
        return RawFrame(self._clock.now_ns(), image=image, stamped_ns=taken_ns, number=self._number)

    def interrupt(self) -> None:
        """End a `read` in progress, if possible."""

    def close(self) -> None:
        """Close the device."""


class MySensor(FrameReader, TactileSensor):
    """Called with keys of the bench file: these, and each of `options` (here `grey`)."""

    def __init__(
        self, serial: str, rate_hz: float, size_px: tuple[int, int], clock: Clock, grey: int = 120
    ) -> None:
        def opened() -> FrameStream:
            return MyStream(rate_hz, size_px, clock, grey)

        super().__init__(
            serial, rate_hz, opened, lambda raw: decode_frame(raw, size_px, upright=False), clock
        )

    def set_light(self, red: float, green: float, blue: float) -> None:
        """Set the LEDs' intensities, 0 to 1, if your sensor has LEDs."""
