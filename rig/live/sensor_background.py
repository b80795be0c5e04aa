"""The background of one sensor on a desk: given, taken from frames, or stored; checked with each frame.

The background of a sensor with a serial is stored when it is taken, and offered at the next start.
"""

from datetime import datetime
from pathlib import Path
from urllib.parse import quote

from drivers.errors import RecordingError
from drivers.images import encode_png, load_image
from drivers.types import Frame, Image
from rig.sessions.files import not_written, state_folder, write_file
from rig.tactile.contact.background import mean_background
from rig.tactile.contact.background_check import BackgroundCheck, gel_change
from rig.tactile.sample import NO_COLOUR, has_colour

BACKGROUND_FRAMES = 15
"""Number of frames that are averaged for the background."""
PRESS_BUTTON = "lift the object, press Take background"
"""Remedy for a doubtful background on the page."""


def _file(serial: str) -> Path:
    return state_folder() / "backgrounds" / f"{quote(serial, safe='')}.png"


def stored_background(serial: str) -> tuple[Image, datetime] | None:
    """Return the stored background of a sensor, (H, W, 3) uint8 RGB, and the local time when it was taken.

    Returns None without one, or if its file cannot be read.
    """
    file = _file(serial)
    image = load_image(file)
    return None if image is None else (image, datetime.fromtimestamp(file.stat().st_mtime))


def store_background(serial: str, image: Image) -> None:
    """Store the background of a sensor. Raises `RecordingError`."""
    file = _file(serial)
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise not_written(file, error) from error
    write_file(file, encode_png(image))


class SensorBackground:
    """The background of one sensor.

    origin: for the user. given: the image, (H, W, 3) uint8 RGB, or None to take it from the first frames.
    serial: under which it is stored, None if it is not. remedy: for a doubtful background, for the user.
    """

    def __init__(self, given: Image | None, serial: str | None, remedy: str = PRESS_BUTTON) -> None:
        self.origin = ""
        self._image: Image | None = None
        self._serial, self._remedy = serial, remedy
        self._stored = None if given is not None or serial is None else stored_background(serial)
        self._frames: list[Image] | None = [] if given is None else None
        self._check: BackgroundCheck | None = None
        self._doubted = False
        if given is not None:
            self._use(given, "the given image")

    @property
    def image(self) -> Image | None:
        """The background, (H, W, 3) uint8 RGB; None while it is taken."""
        return None if self._frames is not None else self._image

    @property
    def doubt(self) -> str:
        """Why the background is doubtful, with the remedy; else an empty text."""
        return "" if self._check is None else self._check.doubt_with(self._remedy)

    @property
    def misfit(self) -> bool:
        """Whether the frames have no angle, because they do not fit the background or are compressed."""
        return self._check is not None and bool(self._check.misfit)

    def take(self) -> None:
        """Take the background from the next frames, whether or not one is stored."""
        self._frames, self._stored = [], None

    def add(self, frame: Frame) -> str:
        """Take the background from a frame, or check it with the frame; return the news for the user."""
        if self._frames is not None:
            self._frames.append(frame.image)
            return self._take_from(self._frames) if len(self._frames) >= BACKGROUND_FRAMES else ""
        if self._check is not None:
            self._check.add(frame.image, frame.time_ns)
        doubted, self._doubted = self._doubted, bool(self.doubt)
        return self._reject() if self._doubted and not doubted else ""

    def _take_from(self, frames: list[Image]) -> str:
        """Use the mean of frames, or the stored background; return the news."""
        self._frames, stored = None, self._stored
        image, news = mean_background(frames), "background taken"
        if stored is not None and stored[0].shape == image.shape:
            news = self._compare(*stored, image)
            if self._image is stored[0]:
                return news
        self._use(image, f"taken at {datetime.now():%H:%M:%S}")
        if not self._doubted and self._serial is not None:
            try:
                store_background(self._serial, image)
                news += f" and stored for serial {self._serial}"
            except RecordingError as error:
                news += f" (not stored: {error})"
        return self._with_doubt(news, image)

    def _compare(self, stored: Image, taken: datetime, now: Image) -> str:
        """Use a stored background unless the present gel shows that it is outdated; return the news."""
        change = gel_change(stored, now)
        name = f"background of serial {self._serial} from {taken:%Y-%m-%d %H:%M}"
        if change.contact not in (None, "now"):
            return f"the gel has changed since the {name} ({change.text}): a new background was taken"
        self._use(stored, f"of serial {self._serial}, from {taken:%Y-%m-%d %H:%M}")
        if change.contact is None:
            return self._with_doubt(f"{name} is used: gel unchanged ({change.text})", now)
        return (
            f"{name} is used: something touches the gel ({change.text}); if nothing does, press Take "
            "background"
        )

    def _use(self, image: Image, origin: str) -> None:
        self._image, self.origin = image, origin
        self._check = BackgroundCheck(image)
        self._doubted = bool(self.doubt)

    def _with_doubt(self, news: str, image: Image) -> str:
        """Return the news, followed by why no angle or a wrong one is expected."""
        doubt = self.doubt or ("" if has_colour(image) else NO_COLOUR)
        return f"{news}; {doubt}" if doubt else news

    def _reject(self) -> str:
        """Return the doubt, and delete the stored background, so that it is not offered at the next start."""
        if self._serial is not None:
            file = _file(self._serial)
            try:
                file.unlink(missing_ok=True)
            except OSError as error:
                return f"{self.doubt} ({file}: cannot be deleted ({error.strerror}))"
        return self.doubt
