"""Differences between simulated sensor units, and the effect of a video codec on their images.

The units of a bench differ as units of one make do (`GelSensor`). For training, units differ more than real
ones (domain randomisation, Tobin et al. 2017). The ranges are our assumptions, chosen wide on purpose; none
was fitted to a real unit. A codec draws coarse blocks and redraws all of them at key frames. The coded image
depends only on the image and its time, so that all readers get the same.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S
from drivers.types import Image

BLOCK_PX = 16
_KEY_S = 0.04
"""Time after a refresh during which images have the lower quality of the key frame."""
_COARSER = 18
_OFFSETS_KEPT = 8


@dataclass(frozen=True, slots=True)
class Variation:
    """Properties in which units differ; the defaults are those of the family.

    slope_at_knee: slope (mm/mm) at which a colour's brightening begins to saturate. near_skirt_px,
    far_skirt_px: reach of the gel's membrane around a contact, in pixels of the geometry; near_share,
    far_share: fraction of the depth at these distances. flatten_mm: depth beyond which the middle of a
    contact becomes flat, 0 for never. rim_per_mm, shadow_per_mm: fraction of light lost per mm of depth at
    the foot of a dent, and right behind it. streak_per_mm: the same in long streaks behind a contact, 0 for
    none. noise: factor on the read-out noise. light_seed: seed of other colours, directions and background,
    None for those of the unit. make_seed: seed of the light of another make, None for a DIGIT. film_px: width
    of the smoothing of relief by the gel's film, in pixels of the geometry. marks_seed: seed of specks and
    scratches of the gel, None for a clean one.
    """

    slope_at_knee: float = 0.24
    near_skirt_px: int = 7
    near_share: float = 0.55
    far_skirt_px: int = 19
    far_share: float = 0.38
    flatten_mm: float = 0.0
    rim_per_mm: float = 3.0
    shadow_per_mm: float = 0.55
    streak_per_mm: float = 0.0
    noise: float = 1.0
    light_seed: int | None = None
    make_seed: int | None = None
    film_px: int = 5
    marks_seed: int | None = None


FAMILY = Variation()
"""The units of a bench."""


def draw_variation(rng: np.random.Generator) -> Variation:
    """Draw a unit at random from the wide ranges for training."""
    return Variation(
        slope_at_knee=float(np.exp(rng.uniform(np.log(0.10), np.log(0.6)))),
        near_skirt_px=int(rng.integers(2, 7)) * 2 + 1,
        near_share=float(rng.uniform(0.3, 0.8)),
        far_skirt_px=int(rng.integers(6, 16)) * 2 + 1,
        far_share=float(rng.uniform(0.1, 0.5)),
        flatten_mm=float(rng.choice([0.0, rng.uniform(0.12, 0.6)])),
        rim_per_mm=float(rng.uniform(0.0, 5.0)),
        shadow_per_mm=float(rng.uniform(0.0, 1.2)),
        streak_per_mm=float(rng.choice([0.0, rng.uniform(0.2, 1.6)])),
        noise=float(rng.uniform(0.4, 2.0)),
        light_seed=int(rng.integers(1 << 31)),
    )


@dataclass(frozen=True, slots=True)
class Codec:
    """One codec. quality: JPEG quality of the blocks. refresh_s: time between key frames.

    block_levels: spread of the blocks' offsets between two key frames, grey levels. seed: of these offsets.
    """

    quality: int
    refresh_s: float
    block_levels: float
    seed: int


def draw_codec(rng: np.random.Generator) -> Codec:
    quality, refresh_s, levels = rng.integers(45, 90), rng.uniform(0.4, 1.6), rng.uniform(0.2, 1.2)
    return Codec(int(quality), float(refresh_s), float(levels), int(rng.integers(1 << 31)))


def apply_codec(image: Image, time_ns: int, codec: Codec) -> Image:
    """Return an image (H, W, 3) uint8 RGB, captured at a time, after the codec."""
    refresh, since_ns = divmod(time_ns, round(codec.refresh_s * NS_PER_S))
    moved = cv2.add(image, _offsets(codec, refresh, image.shape[:2]), dtype=cv2.CV_8U)
    quality = codec.quality - (_COARSER if since_ns < _KEY_S * NS_PER_S else 0)
    return jpeg(np.asarray(moved, np.uint8), quality)


def encode_jpeg(image: Image, quality: int) -> bytes:
    """Return an image (H, W, 3) uint8 RGB as JPEG with a quality from 1 to 100."""
    blue_first = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".jpg", blue_first, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def decode_jpeg(data: bytes) -> Image:
    """Return a JPEG as image (H, W, 3) uint8 RGB."""
    return np.asarray(cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB), np.uint8)


def jpeg(image: Image, quality: int) -> Image:
    """Return an image (H, W, 3) uint8 RGB after JPEG compression with a quality from 1 to 100."""
    return decode_jpeg(encode_jpeg(image, quality))


@lru_cache(maxsize=_OFFSETS_KEPT)
def _offsets(codec: Codec, refresh: int, shape: tuple[int, int]) -> NDArray[np.int16]:
    """Return the offset of each block between two key frames, (H, W, 3) grey levels."""
    rows, columns = (-(-size // BLOCK_PX) for size in shape)
    levels = np.random.default_rng((codec.seed, refresh)).normal(0.0, codec.block_levels, (rows, columns, 3))
    wide = np.rint(levels).astype(np.int16).repeat(BLOCK_PX, axis=0).repeat(BLOCK_PX, axis=1)
    return np.ascontiguousarray(wide[: shape[0], : shape[1]])


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
