"""`import rig` beside modules of the user that have the name of a package of the slip rig."""

import subprocess
import sys
from pathlib import Path

import pytest

PACKAGES = ("drivers", "fakes", "calibration", "protocols")
USE = "import rig; rig.estimate; print('used')"


def run(folder: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, *words], cwd=folder, capture_output=True, text=True, check=False, timeout=120
    )


def require_named(done: "subprocess.CompletedProcess[str]", place: Path) -> None:
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last.startswith(f"rig.HiddenPackageError: Python finds {place} before the package '{place.stem}'")
    assert f"Rename it, or move it into a package of your own, as my_lab/{place.name}" in last


def hidden(folder: Path, name: str) -> Path:
    (folder / name).mkdir(parents=True)
    (folder / name / "__init__.py").touch()
    return folder / name


@pytest.mark.parametrize("name", PACKAGES)
def test_folder_that_hides_a_package_is_named(tmp_path: Path, name: str) -> None:
    place = hidden(tmp_path, name)
    require_named(run(tmp_path, "-c", "import rig"), place)


def test_file_that_hides_a_package_is_named(tmp_path: Path) -> None:
    (tmp_path / "drivers.py").touch()
    require_named(run(tmp_path, "-c", "import rig"), tmp_path / "drivers.py")


def test_folder_beside_a_script_is_named(tmp_path: Path) -> None:
    place = hidden(tmp_path / "lab", "drivers")
    (tmp_path / "lab" / "measure.py").write_text("from rig.tactile.sample import SlipSample")
    require_named(run(tmp_path, "lab/measure.py"), place)


def test_folder_of_another_root_on_the_path_is_named(tmp_path: Path) -> None:
    place = hidden(tmp_path / "lab", "calibration")
    require_named(run(tmp_path, "-c", "import sys; sys.path.insert(0, 'lab'); import rig"), place)


def test_folder_that_is_added_to_the_path_after_the_import_is_named(tmp_path: Path) -> None:
    place = hidden(tmp_path / "lab", "drivers")
    code = "import rig, sys; sys.path.insert(0, 'lab'); rig.estimate"
    require_named(run(tmp_path, "-c", code), place)


def test_package_of_the_user_that_is_loaded_already_is_named(tmp_path: Path) -> None:
    place = hidden(tmp_path / "lab", "fakes")
    code = "import sys; sys.path.insert(0, 'lab'); import fakes; del sys.path[0]; import rig"
    require_named(run(tmp_path, "-c", code), place)


def test_folder_is_named_when_a_module_of_the_user_is_run(tmp_path: Path) -> None:
    place = hidden(tmp_path, "drivers")
    (tmp_path / "measure.py").write_text("import rig")
    require_named(run(tmp_path, "-m", "measure"), place)


def test_folder_is_named_in_tests_of_the_user(tmp_path: Path) -> None:
    place = hidden(tmp_path, "drivers")
    (tmp_path / "test_mine.py").write_text("import rig")
    done = run(tmp_path, "-m", "pytest", "-q", "test_mine.py")
    assert f"HiddenPackageError: Python finds {place} before" in done.stdout


@pytest.mark.parametrize("name", [*PACKAGES, "rig"])
def test_folder_without_init_file_hides_nothing(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    assert run(tmp_path, "-c", USE).stdout == "used\n"


def test_rig_run_as_a_module_ignores_the_current_folder(tmp_path: Path) -> None:
    hidden(tmp_path, "drivers")
    assert run(tmp_path, "-m", "rig", "--version").stdout.startswith("rig ")
