"""What a simulated gel needs to know of a real unit's look."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float32]


class Look(Protocol):
    """A unit's own colours, background and noise, in place of a made-up light.

    The bench hands over a `calibration.gel.look.GelLook`, so that the simulator imports no calibration.
    """

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of its images."""
        ...

    @property
    def mm_per_px(self) -> tuple[float, float]:
        """Scale along x and y."""
        ...

    @property
    def dome_mm(self) -> float:
        """Radius of the gel's convex face."""
        ...

    @property
    def background(self) -> Plane:
        """(H, W, 3) grey levels of the untouched gel, RGB."""
        ...

    @property
    def noise(self) -> Plane:
        """(N, H, W, 3) grey levels of the noise of some frames."""
        ...

    @property
    def jpeg_quality(self) -> int | None:
        """Of its frames; None if they are not compressed."""
        ...

    def varied(self, seed: int) -> "Look":
        """A plausible other unit: LEDs turned, gains and noise changed."""
        ...

    def dent(self, pressed: Plane, dragged: Plane) -> Plane:
        """Depth of the film (h, w) mm; pressed: under the object, dragged: the same for the membrane."""
        ...

    def change(self, dent: Plane) -> Plane:
        """Colour change (h, w, 3) grey levels of a dent (h, w) mm, at half the image's resolution."""
        ...
