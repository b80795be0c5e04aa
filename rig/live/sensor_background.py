"""The background of one sensor on a desk: given, taken from frames, or stored; checked with each frame."""

from datetime import datetime

from drivers.errors import RecordingError
from drivers.types import Frame, Image
from rig.live.stored_backgrounds import (
    StoredBackground,
    forget_background,
    store_background,
    stored_background,
)
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.background_check import (
    CHECK_EVERY_NS,
    BackgroundCheck,
    gel_change,
)
from rig.tactile.sample import NO_COLOUR, has_colour

BACKGROUND_FRAMES = 15
"""Number of frames that are averaged for the background."""
PRESS = "press an object on the gel"


class SensorBackground:
    """The background of one sensor.

    image: (H, W, 3) uint8 RGB, None until it is taken. origin: its origin, for the user. given: the image, or
    None to take it from the first frames. serial: under which it is stored, None if it is not.
    """

    def __init__(self, given: Image | None, serial: str | None) -> None:
        self.image: Image | None = None
        self.origin = ""
        self._serial = serial
        self._stored = None if given is not None or serial is None else stored_background(serial)
        self._frames: list[Image] | None = [] if given is None else None
        self._check: BackgroundCheck | None = None
        self._doubted = False
        if given is not None:
            self._use(given, "the given image")

    @property
    def collecting(self) -> bool:
        """Whether the background is being taken."""
        return self._frames is not None

    @property
    def doubt(self) -> str:
        """Why the background is doubtful, with the remedy; else an empty text."""
        doubt = "" if self._check is None else self._check.doubt
        return f"{doubt}: lift the object, press Take background" if doubt else ""

    @property
    def misfit(self) -> bool:
        """Whether the frames do not fit the background, so that they have no angle."""
        return self._check is not None and bool(self._check.misfit)

    def take(self) -> None:
        """Take the background from the next frames, whether or not one is stored."""
        self._frames, self._stored = [], None

    def add(self, frame: Frame) -> str:
        """Take the background from a frame, or check it with the frame; return the news for the user."""
        if self._frames is not None:
            self._frames.append(frame.image)
            return self._taken(self._frames) if len(self._frames) >= BACKGROUND_FRAMES else ""
        if self._check is not None:
            self._check.add(frame.image, frame.time_ns)
        doubted, self._doubted = self._doubted, bool(self.doubt)
        return self._reject() if self._doubted and not doubted else ""

    def _taken(self, frames: list[Image]) -> str:
        self._frames, stored = None, self._stored
        image = mean_background(frames)
        news = "background taken"
        if stored is not None and stored.image.shape == image.shape:
            news = self._compared(stored, image)
            if self.image is stored.image:
                return news
        self._use(image, f"taken at {datetime.now():%H:%M:%S}")
        if not self._doubted and self._serial is not None:
            news += self._kept(self._serial, image)
        return self._next(news, image)

    def _compared(self, stored: StoredBackground, now: Image) -> str:
        """Use a stored background unless the present gel shows that it is outdated; return the news."""
        change = gel_change(stored.image, now)
        name = f"background of serial {self._serial} from {stored.taken:%Y-%m-%d %H:%M}"
        if change.contact not in (None, "now"):
            return f"the gel has changed since the {name} ({change.text}): a new background was taken"
        self._use(stored.image, f"of serial {self._serial}, from {stored.taken:%Y-%m-%d %H:%M}")
        if change.contact is None:
            return self._next(f"{name} is used: gel unchanged ({change.text})", now)
        return (
            f"{name} is used: something touches the gel ({change.text}); if nothing does, press Take "
            "background"
        )

    def _use(self, image: Image, origin: str) -> None:
        self.image, self.origin = image, origin
        self._check = BackgroundCheck(image, CHECK_EVERY_NS)
        self._doubted = bool(self.doubt)

    def _next(self, news: str, image: Image) -> str:
        """Return the news, followed by the next step for the user."""
        return f"{news}; {self.doubt or (PRESS if has_colour(image) else NO_COLOUR)}"

    def _kept(self, serial: str, image: Image) -> str:
        """Store the background; return the addition to the news."""
        try:
            store_background(serial, image)
        except RecordingError as error:
            return f" (not stored: {error})"
        return f" and stored for serial {serial}"

    def _reject(self) -> str:
        """Return the doubt, and do not offer the background at the next start."""
        if self._serial is None:
            return self.doubt
        try:
            forget_background(self._serial)
        except RecordingError as error:
            return f"{self.doubt} ({error})"
        return self.doubt
