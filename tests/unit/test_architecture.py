"""The environment and the packages. `.ci/run` checks style, import contracts and the wheel."""

import importlib
import re
import subprocess
import sys
from importlib.metadata import files, version
from pathlib import Path

import pytest

from support.benches import real_bench_file

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("rig", "drivers", "fakes", "calibration", "protocols")


def test_all_packages_come_from_one_place() -> None:
    """A foreign `calibration` or `drivers` in the environment would shadow ours."""
    parents = {Path(importlib.import_module(name).__file__ or "").parents[1] for name in PACKAGES}
    assert parents == {ROOT}


def test_exactly_one_distribution_provides_cv2() -> None:
    import cv2

    variants = ("python", "python-headless", "contrib-python", "contrib-python-headless")
    assert [name for name in variants if _installed(f"opencv-{name}")] == ["contrib-python-headless"]
    assert Path(cv2.__file__).parent.exists()


def _installed(name: str) -> bool:
    try:
        return bool(version(name) and files(name))
    except importlib.metadata.PackageNotFoundError:
        return False


@pytest.mark.slow
def test_rig_works_without_the_arm_library_and_pytest(tmp_path: Path) -> None:
    """Check that everything except the arm works, and that a real bench can be created."""
    code = (
        "import sys; lacking = ('rtde_control', 'rtde_receive', 'pytest', 'hypothesis');"
        "sys.modules.update(dict.fromkeys(lacking));"
        "import rig.experiments.record, rig.experiments.replay, rig.experiments.trial, rig.cli.main;"
        "import rig.bench.source, rig.benchmark.estimators.study;"
        "import rig.doctor.examination, rig.benchmark.wire.faults;"
        "from rig.bench.assembly import build_real_bench; from rig.config import load_bench;"
        f"print(build_real_bench(load_bench({str(real_bench_file(tmp_path))!r})).name)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[:1] == ["my bench"], done.stderr


@pytest.mark.parametrize("package", PACKAGES)
def test_every_package_has_a_docstring_and_py_typed(package: str) -> None:
    assert (importlib.import_module(package).__doc__ or "").strip()
    assert (ROOT / package / "py.typed").exists()


def test_only_the_contract_checks_import_pytest_and_hypothesis() -> None:
    importing = {
        path.relative_to(ROOT).parts[:2]
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if re.search(
            r"^\s*(import|from) (pytest|hypothesis)\b", path.read_text(encoding="utf-8"), re.MULTILINE
        )
        and "templates" not in path.parts
    }
    assert importing == {("rig", "contract_checks.py")}
