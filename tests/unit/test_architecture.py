"""The environment, the packages, and how the suite runs. `.ci/run` checks style, imports and the wheel."""

import importlib
import os
import re
import subprocess
import sys
import tomllib
from importlib.metadata import files, version
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from support.benches import real_bench_file
from support.side_by_side import pytest_configure, pytest_xdist_auto_num_workers

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


@pytest.mark.heavy
def test_rig_works_without_the_arm_library_and_pytest(tmp_path: Path) -> None:
    """Check that everything except the arm works, and that a real bench can be created."""
    code = (
        "import sys; lacking = ('rtde_control', 'rtde_receive', 'pytest', 'hypothesis');"
        "sys.modules.update(dict.fromkeys(lacking));"
        "import rig.experiments.record, rig.experiments.replay, rig.experiments.trial, rig.cli.main;"
        "import rig.bench.source, rig.benchmark.estimators.study;"
        "import rig.doctor.examination, rig.benchmark.wire.safety;"
        "from rig.bench.assembly import build_real_bench; from rig.config import load_bench;"
        f"print(build_real_bench(load_bench({str(real_bench_file(tmp_path))!r})).name)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.stdout.splitlines()[:1] == ["my bench"], done.stderr


def test_contract_forbids_imports_of_every_program_of_tools() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = settings["tool"]["importlinter"]["contracts"]
    forbidden = next(of["forbidden_modules"] for of in contracts if of["name"].endswith("of tools"))
    assert set(forbidden) == {path.stem for path in (ROOT / "tools").glob("*.py")}


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


def test_several_workers_with_hardware_are_rejected() -> None:
    config: Any = SimpleNamespace(getoption={"--bench": "my_bench.toml", "tx": ["2*popen"]}.get)
    with pytest.raises(pytest.UsageError, match="two workers must not drive one arm"):
        pytest_configure(config)


@pytest.mark.heavy
def test_hardware_tests_run_without_workers() -> None:
    """The suite runs as a person at a bench does it."""
    command = [sys.executable, "-m", "pytest", "tests/contract", "-k", "motions_outside and fake"]
    alone = {name: value for name, value in os.environ.items() if not name.startswith("PYTEST_")}
    done = subprocess.run(
        [*command, "--bench", "nowhere.toml"], cwd=ROOT, env=alone, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert "1 passed" in done.stdout
    assert "bringing up nodes" not in done.stdout


@pytest.mark.parametrize(
    ("arguments", "bench", "workers"),
    [(["tests"], None, 4), (["tests"], "my_bench.toml", 0), (["tests/unit/test_architecture.py"], None, 0)],
)
def test_workers_are_used_for_simulated_devices_only(
    arguments: list[str], bench: str | None, workers: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0, 1}, raising=False)
    config: Any = SimpleNamespace(args=arguments, getoption={"--bench": bench}.get)
    assert pytest_xdist_auto_num_workers(config) == workers
