"""What is doubtful about a series of frames and its background, before anything is estimated from them."""

from collections.abc import Sequence
from itertools import islice

import numpy as np

from drivers.types import Image
from rig.frames.series import ENOUGH_FRAMES, FrameSeries, evenly_spread
from rig.tactile.contact.background import auto_background, structure
from rig.tactile.contact.untouched import Comparison

# The first frame is held against so many after it; darker than this share of their light is dark.
AFTER_FIRST = 5
DARK_SHARE = 0.7
# So many frames, evenly spread, say what the gel looks like without contact.
COMPARED = 30
# A background is called touched where that is plainer by this factor; a median of frames without noise is by
# 0.96 to 0.98.
PLAINER = 0.95


def frame_doubts(series: FrameSeries) -> list[str]:
    """Say what is wrong with the first frame, which a camera may have kept from before or taken too dark."""
    images = list(islice(series.images(), 1 + AFTER_FIRST))
    if len(images) <= AFTER_FIRST:
        return []
    first, *after = images
    light = float(np.median([image.mean() for image in after]))
    if first.mean() < DARK_SHARE * light:
        return [f"the first frame is dark (mean {first.mean():.0f}, the next ones {light:.0f}): leave it out"]
    if _differs(after[0], first) and not any(_differs(after[0], image) for image in after[1:]):
        return [
            "the first frame shows something else than those after it: leave it out if the camera kept it "
            "from before"
        ]
    return []


def background_doubts(spec: str | None, background: Image, series: FrameSeries) -> list[str]:
    """Say why a background that was asked for may show a contact. spec: as `make_background` takes it."""
    if spec is None or spec == "auto":
        return []
    if spec.startswith("first:"):
        images = list(islice(series.images(), int(spec.removeprefix("first:"))))
        if odd := _odd_ones(background, images):
            return [
                f"the frames of --background {spec} are not alike (frame {odd[0]} differs): a contact begins "
                "among them, or one is from before; give fewer or an IMAGE"
            ]
    frames = evenly_spread(series.images(), COMPARED)
    if len(frames) >= ENOUGH_FRAMES and _shows_contact(background, auto_background(frames)):
        return [
            "the background seems to show a contact, which other frames do not: give an IMAGE without one, "
            "or --background auto"
        ]
    return []


def _shows_contact(background: Image, made: Image) -> bool:
    """Whether a background differs from the one made of the frames, and is the less plain of the two."""
    return _differs(made, background) and structure(made) < PLAINER * structure(background)


def _odd_ones(background: Image, images: Sequence[Image]) -> list[int]:
    comparison = Comparison(background)
    return [number for number, image in enumerate(images) if comparison.region(image) is not None]


def _differs(background: Image, image: Image) -> bool:
    return Comparison(background).region(image) is not None
