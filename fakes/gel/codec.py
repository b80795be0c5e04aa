"""What a video codec does to a sensor's pictures: blocks, and key frames that draw all of them anew.

Each picture is made from its time alone, so that it looks the same whoever reads when.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from drivers.clock import NS_PER_S
from drivers.types import Image

BLOCK_PX = 16
_KEY_S = 0.04
"""So long after a refresh pictures are those of the key frame itself, which is coarser."""
_COARSER = 18
_OFFSETS_KEPT = 8


@dataclass(frozen=True, slots=True)
class Codec:
    """One codec. quality: of a picture's blocks, as JPEG counts it. refresh_s: from key frame to key frame.

    block_levels: how far, in grey levels, blocks are off from one key frame to the next. seed: of which.
    """

    quality: int
    refresh_s: float
    block_levels: float
    seed: int


def draw_codec(rng: np.random.Generator) -> Codec:
    """Draw a codec."""
    return Codec(
        int(rng.integers(45, 90)),
        float(rng.uniform(0.4, 1.6)),
        float(rng.uniform(0.2, 1.2)),
        int(rng.integers(1 << 31)),
    )


def coded(image: Image, time_ns: int, codec: Codec) -> Image:
    """Return a picture (H, W, 3) uint8 RGB of a time as the codec leaves it."""
    refresh, since_ns = divmod(time_ns, round(codec.refresh_s * NS_PER_S))
    moved = cv2.add(image, _offsets(codec, refresh, image.shape[:2]), dtype=cv2.CV_8U)
    quality = codec.quality - (_COARSER if since_ns < _KEY_S * NS_PER_S else 0)
    blue_first = cv2.cvtColor(moved, cv2.COLOR_RGB2BGR)
    _, data = cv2.imencode(".jpg", blue_first, (cv2.IMWRITE_JPEG_QUALITY, quality))
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR_RGB), np.uint8)


@lru_cache(maxsize=_OFFSETS_KEPT)
def _offsets(codec: Codec, refresh: int, shape: tuple[int, int]) -> NDArray[np.int16]:
    """How far each block is off between two key frames, (H, W, 3) grey levels."""
    rows, columns = (-(-size // BLOCK_PX) for size in shape)
    levels = np.random.default_rng((codec.seed, refresh)).normal(0.0, codec.block_levels, (rows, columns, 3))
    wide = np.rint(levels).astype(np.int16).repeat(BLOCK_PX, axis=0).repeat(BLOCK_PX, axis=1)
    return np.ascontiguousarray(wide[: shape[0], : shape[1]])
