"""The wheel contains the packages with their data, and runs from an empty folder without the source tree."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("rig", "drivers", "fakes", "calibration", "protocols")


@pytest.fixture(scope="module")
def unpacked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What an installer of the wheel puts on a computer."""
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    (wheel,) = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder / "site")
    return folder / "site"


def test_wheel_holds_the_packages_and_their_data_only(unpacked: Path) -> None:
    inside = {p.relative_to(unpacked).as_posix() for p in unpacked.rglob("*") if p.is_file()}
    here = {
        p.relative_to(ROOT).as_posix()
        for package in PACKAGES
        for p in (ROOT / package).rglob("*")
        if p.is_file() and "__pycache__" not in p.parts
    }
    assert here <= inside
    others = {name.split("/")[0] for name in inside - here}
    assert all(name.endswith(".dist-info") for name in others), others
    endings = {Path(name).suffix for name in inside}
    assert {".onnx", ".toml", ".html", ".css", ".csv", ".rules"} <= endings


@pytest.mark.parametrize(
    ("command", "printed"),
    [
        (("trial", "--object", "wrench", "--lifts", "1", "--dry-run"), "nothing was moved"),
        (("model", "list"), "ours"),
        pytest.param(("bench", "new", "my_bench.toml"), "my_bench.toml", marks=pytest.mark.long),
    ],
)
def test_commands_find_their_data_in_the_wheel(
    unpacked: Path, tmp_path: Path, command: tuple[str, ...], printed: str
) -> None:
    # nothing has been compiled for this place, and compiling takes longer than the commands
    environment = {**os.environ, "PYTHONPATH": str(unpacked), "NUMBA_DISABLE_JIT": "1"}
    code = "import sys, rig; assert rig.__file__.startswith(sys.argv.pop(1)); import runpy; "
    code += "runpy.run_module('rig', run_name='__main__')"
    done = subprocess.run(
        [sys.executable, "-c", code, str(unpacked), *command],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    assert printed in done.stdout + done.stderr
