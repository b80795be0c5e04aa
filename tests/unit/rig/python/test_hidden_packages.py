"""`import rig` beside modules of the user that have the name of a package of the slip rig."""

import subprocess
import sys
from pathlib import Path

import pytest

from support.marks import heavy

PACKAGES = ("drivers", "fakes", "calibration", "protocols")
USE = "import rig; rig.estimate; print('used')"


def run(folder: Path, *words: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, *words], cwd=folder, capture_output=True, text=True, check=False, timeout=120
    )


def hidden(folder: Path, name: str) -> Path:
    """Create a package, or an empty file NAME.py."""
    file = folder / name if name.endswith(".py") else folder / name / "__init__.py"
    file.parent.mkdir(parents=True, exist_ok=True)
    file.touch()
    return folder / name


LATER = "import sys; sys.path.insert(0, 'lab'); "


@pytest.mark.parametrize(
    ("place", "files", "words"),
    [
        *((name, {}, ("-c", "import rig")) for name in PACKAGES),
        ("drivers.py", {}, ("-c", "import rig")),
        ("lab/drivers", {"lab/measure.py": "from rig.tactile.sample import SlipSample"}, ("lab/measure.py",)),
        ("lab/calibration", {}, ("-c", f"{LATER}import rig")),
        ("lab/drivers", {}, ("-c", f"import rig; {LATER}rig.estimate")),
        ("lab/fakes", {}, ("-c", f"{LATER}import fakes; del sys.path[0]; import rig")),
        ("drivers", {"measure.py": "import rig"}, ("-m", "measure")),
    ],
)
def test_module_of_the_user_that_hides_a_package_is_named(
    tmp_path: Path, place: str, files: dict[str, str], words: tuple[str, ...]
) -> None:
    hiding = hidden(tmp_path, place)
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    done = run(tmp_path, *words)
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last.startswith(
        f"rig.HiddenPackageError: Python finds {hiding} before the package '{hiding.stem}'"
    )
    assert f"Rename it, or move it into a package of your own, as my_lab/{hiding.name}" in last


@pytest.mark.heavy
def test_folder_is_named_in_tests_of_the_user(tmp_path: Path) -> None:
    place = hidden(tmp_path, "drivers")
    (tmp_path / "test_mine.py").write_text("import rig")
    done = run(tmp_path, "-m", "pytest", "-q", "test_mine.py")
    assert f"HiddenPackageError: Python finds {place} before" in done.stdout


@pytest.mark.heavy
@pytest.mark.parametrize("name", ["drivers", *heavy(*PACKAGES[1:], "rig")])
def test_folder_without_init_file_hides_nothing(tmp_path: Path, name: str) -> None:
    (tmp_path / name).mkdir()
    assert run(tmp_path, "-c", USE).stdout == "used\n"


def test_rig_run_as_a_module_ignores_the_current_folder(tmp_path: Path) -> None:
    hidden(tmp_path, "drivers")
    assert run(tmp_path, "-m", "rig", "--version").stdout.startswith("rig ")
