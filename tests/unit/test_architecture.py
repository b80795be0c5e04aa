"""What holds the product together beside its behaviour: layers, style, packing."""

import importlib
import subprocess
import sys
import tomllib
from importlib.metadata import files, version
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("rig", "drivers", "fakes", "calibration", "protocols")


def tool(*command: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_ruff_finds_nothing() -> None:
    tool("ruff", "check", ".")
    tool("ruff", "format", "--check", ".")


def test_imports_keep_the_layers() -> None:
    code = "import sys; from importlinter.cli import lint_imports_command; lint_imports_command()"
    done = subprocess.run(
        [sys.executable, "-c", code, "--no-cache"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "5 kept, 0 broken" in done.stdout


def test_no_driver_is_left_out_of_the_contract_that_keeps_fakes_from_it() -> None:
    names = ("interfaces", "bench", "types", "errors", "clock", "punctual")
    vocabulary = {f"drivers.{name}" for name in names}
    modules = {f"drivers.{path.stem}" for path in (ROOT / "drivers").glob("*.py")} - {"drivers.__init__"}
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    forbidden = next(
        set(c["forbidden_modules"]) for c in contracts if "protocols" in c.get("source_modules", ())
    )
    assert modules - vocabulary <= forbidden


def test_all_packages_come_from_one_place() -> None:
    """A foreign `calibration` or `drivers` in the environment would shadow ours."""
    parents = {Path(importlib.import_module(name).__file__ or "").parents[1] for name in PACKAGES}
    assert parents == {ROOT}


def test_exactly_one_distribution_provides_cv2() -> None:
    import cv2

    folder = Path(cv2.__file__).parent
    owners = [
        name
        for name in (
            "opencv-python",
            "opencv-python-headless",
            "opencv-contrib-python",
            "opencv-contrib-python-headless",
        )
        if _installed(name)
    ]
    assert owners == ["opencv-contrib-python-headless"]
    assert folder.exists()


def _installed(name: str) -> bool:
    try:
        return bool(version(name) and files(name))
    except importlib.metadata.PackageNotFoundError:
        return False


def test_the_arm_library_is_imported_by_nothing_here() -> None:
    """Everything but the arm works where ur-rtde has no wheel; a whole real bench can be made."""
    code = (
        "import sys; sys.modules.update({'rtde_control': None, 'rtde_receive': None});"
        "import rig.record, rig.replay, rig.cli.main, rig.doctor.examination, rig.benchmark.faults;"
        "from rig.assembly import build_real_bench; from rig.config import load_bench;"
        "print(build_real_bench(load_bench('rig/config/new_bench.toml')).name)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[:1] == ["my bench"], done.stderr


@pytest.mark.parametrize("package", PACKAGES)
def test_every_package_says_what_it_is_and_is_typed(package: str) -> None:
    assert (importlib.import_module(package).__doc__ or "").strip()
    assert (ROOT / package / "py.typed").exists()
