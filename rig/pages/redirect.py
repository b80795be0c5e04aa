"""Open a page in a browser without showing its secret on the browser's command line."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def way_to(address: str) -> Iterator[str]:
    """Give the address of a file that redirects a browser to `address`; only this user can read the file.

    Otherwise `ps` would show the secret in the address to every user of the computer.
    """
    with tempfile.TemporaryDirectory(prefix="rig-page-") as folder:  # made with mode 0700
        file = Path(folder) / "page.html"
        file.touch(mode=0o600)
        file.write_text(f'<!doctype html><meta http-equiv="refresh" content="0; url={address}">')
        yield file.as_uri()
