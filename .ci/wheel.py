"""Build the wheel; it holds the packages with their data only, and runs from an empty folder."""

import os
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("rig", "drivers", "fakes", "calibration", "protocols")
ENDINGS = {".onnx", ".toml", ".html", ".css", ".csv", ".rules"}
COMMANDS = {
    ("trial", "--object", "wrench", "--lifts", "1", "--dry-run"): "nothing was moved",
    ("model", "list"): "ours",
    ("bench", "new", "my_bench.toml"): "my_bench.toml",
}
RUN = (
    "import sys, rig, runpy; assert rig.__file__.startswith(sys.argv.pop(1)), rig.__file__; "
    "runpy.run_module('rig', run_name='__main__')"
)

with tempfile.TemporaryDirectory() as made:
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", made], cwd=ROOT, check=True
    )
    site, empty = Path(made, "site"), Path(made, "empty")
    empty.mkdir()
    zipfile.ZipFile(next(Path(made).glob("*.whl"))).extractall(site)
    inside = {path.relative_to(site).as_posix() for path in site.rglob("*") if path.is_file()}
    here = {
        path.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for path in (ROOT / package).rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    others = {name for name in inside - here if not name.split("/")[0].endswith(".dist-info")}
    if here - inside or others or not {Path(name).suffix for name in inside} >= ENDINGS:
        sys.exit(
            f"wheel: missing {sorted(here - inside)}, not the rig's {sorted(others)}, or without {ENDINGS}"
        )
    environment = {**os.environ, "PYTHONPATH": str(site)}
    for words, printed in COMMANDS.items():
        done = subprocess.run(
            [sys.executable, "-c", RUN, str(site), *words],
            cwd=empty,
            env=environment,
            capture_output=True,
            text=True,
        )
        if done.returncode or printed not in done.stdout + done.stderr:
            sys.exit(f"wheel: rig {' '.join(words)}: {done.stdout}{done.stderr}")
