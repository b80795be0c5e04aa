"""Build the site of docs; it documents each name of `import rig`, has every page, and needs no network."""

import re
import subprocess
import sys
import tempfile
from pathlib import Path

import rig

DOCS = Path(__file__).resolve().parents[1] / "docs"

with tempfile.TemporaryDirectory() as made:
    command = [sys.executable, "-m", "sphinx", "-W", "-q", "-b", "html", str(DOCS), made]
    subprocess.run(command, check=True)  # -W: a warning is an error
    page, index = (Path(made, name).read_text(encoding="utf-8") for name in ("python.html", "index.html"))
missing = [name for name in rig.__all__ if f'id="rig.{name}"' not in page]
fetched = re.findall(r'<(?:script|link|img)[^>]*(?:src|href)="(https?://[^"]+)"', index)
listed, pages = index.count("toctree-l1"), len(list(DOCS.glob("*.md"))) - 1
if missing or fetched or listed < pages:
    sys.exit(f"site: undocumented names {missing}; fetched {fetched}; {listed} of {pages} pages are listed")
