"""Interface of a real unit's look, as the simulated gel uses it."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float32]


class Look(Protocol):
    """Colours, background and noise of a real unit, used in place of a simulated illumination.

    The bench passes a `calibration.gel.look.GelLook`, so that the simulator does not import `calibration`.
    """

    @property
    def shape(self) -> tuple[int, int]: ...

    @property
    def mm_per_px(self) -> tuple[float, float]: ...

    @property
    def dome_mm(self) -> float: ...

    @property
    def background(self) -> Plane:
        """(H, W, 3) grey levels of the untouched gel, RGB."""
        ...

    @property
    def jpeg_quality(self) -> int | None:
        """JPEG quality of its frames; None if they are not compressed."""
        ...

    def draw_noise(self, shape: tuple[int, int], count: int, rng: np.random.Generator) -> Plane:
        """Draw fields of noise, (count, H, W, 3) grey levels."""
        ...

    def varied(self, seed: int) -> "Look":
        """Return the look of another plausible unit, with other LED directions, gains and noise."""
        ...

    def dent(self, pressed: Plane, dragged: Plane) -> Plane:
        """Return the depth of the film, (h, w) mm.

        pressed: depth under the object. dragged: the same, for the membrane that trails behind the object.
        """
        ...

    def change(self, dent: Plane) -> Plane:
        """Return the colour change (h, w, 3) of a dent (h, w) mm, in grey levels, at half resolution."""
        ...
