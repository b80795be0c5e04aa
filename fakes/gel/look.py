"""Interface of a real unit's look, as the simulated gel uses it."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float32]


class Look(Protocol):
    """Colours, background and noise of a real unit, used in place of a simulated illumination.

    The bench passes a `calibration.gel.look.GelLook`, which describes the members; so the simulator does not
    import `calibration`.
    """

    @property
    def shape(self) -> tuple[int, int]: ...

    @property
    def mm_per_px(self) -> tuple[float, float]: ...

    @property
    def dome_mm(self) -> float: ...

    @property
    def background(self) -> Plane: ...

    @property
    def jpeg_quality(self) -> int | None: ...

    def draw_noise(self, shape: tuple[int, int], count: int, rng: np.random.Generator) -> Plane: ...

    def varied(self, seed: int) -> "Look": ...

    def dent(self, pressed: Plane, dragged: Plane) -> Plane: ...

    def change(self, dent: Plane) -> Plane: ...
