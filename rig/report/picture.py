"""A screenshot of the top of a report in a browser."""

import os
import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

from drivers.errors import InputError, RecordingError
from rig.sessions.files import write_file

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
SIZE_PX = (1200, 1300)
ENDING = ".png"
_AT_MOST_S = 60.0


def require_picture(out: Path) -> str:
    """Return the browser's program. Raises `InputError` if none is installed, or for another ending."""
    if out.suffix.lower() != ENDING:
        raise InputError(f"{out}: a report's picture is a {ENDING}; choose another --picture")
    found = next(filter(None, map(shutil.which, BROWSERS)), None)
    if found is None:
        raise InputError("--picture needs a browser: install chromium, or take the picture in your own")
    return found


def picture_of(page: Path, out: Path) -> None:
    """Write a screenshot of `SIZE_PX` of a page. Raises `RecordingError` if the browser fails."""
    browser = require_picture(out)
    with TemporaryDirectory(prefix="rig-picture-") as folder:
        taken = Path(folder) / "page.png"
        flags = ["--headless", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={folder}/profile"]
        as_root = ["--no-sandbox"] if os.geteuid() == 0 else []  # as root it does not start otherwise
        size = f"--window-size={SIZE_PX[0]},{SIZE_PX[1]}"
        command = [browser, *flags, *as_root, size, f"--screenshot={taken}", page.resolve().as_uri()]
        try:
            subprocess.run(command, capture_output=True, timeout=_AT_MOST_S, check=True)  # noqa: S603
            picture = taken.read_bytes()
        except (OSError, subprocess.SubprocessError) as error:
            raise RecordingError(
                f"{page}: {browser} took no picture ({type(error).__name__}); take it in your own browser"
            ) from error
    write_file(out, picture)
