"""Commands that start processes import nothing from the current folder, whose files may be untrusted.

Without --all, the source is searched for other ways to start a process.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.waiting import LIMIT_S

ROOT = Path(__file__).parents[2]
SHADOWED = (
    "threading", "multiprocessing", "socket", "json", "pickle", "tempfile", "signal", "random", "selectors",
    "asyncio", "numpy", "cv2", "rig", "drivers", "fakes", "protocols", "calibration",
)  # fmt: skip
SHADOW = """
open({log!r}, "a").write(__name__ + "\\n")
raise SystemExit(__name__ + " of the current folder was run")
"""
RIG = (str(Path(sys.executable).with_name("rig")),)
MODULE = (sys.executable, "-m", "rig")
DEADLINE_S = LIMIT_S


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a session whose folder contains files with the names of modules."""
    folder = tmp_path / "session"
    shutil.copytree(ROOT / "tests" / "data" / "stored_trial", folder)
    for name in SHADOWED:
        text = SHADOW.format(log=str(tmp_path / "run"))
        if name in ("multiprocessing", "asyncio", "rig", "drivers", "fakes", "protocols", "calibration"):
            (folder / name).mkdir()
            (folder / name / "__init__.py").write_text(text)
        else:
            (folder / f"{name}.py").write_text(text)
    return folder


def check(folder: Path, *words: object, program: tuple[str, ...] = RIG, codes: tuple[int, ...] = (0,)) -> str:
    """Run a command in the folder; return its output. codes: the exit codes that it may have."""
    done = subprocess.run(
        [*program, *map(str, words)], cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True,
        timeout=DEADLINE_S, check=False,
    )  # fmt: skip
    assert not (folder.parent / "run").exists(), (folder.parent / "run").read_text() + done.stderr
    assert done.returncode in codes, done.stderr
    return done.stdout


@pytest.mark.heavy
def test_trial_in_several_processes_with_page(folder: Path, light_bench_file: Path) -> None:
    out = folder.parent / "out"
    check(
        folder, "trial", "--lifts", 2, "--object", "toothbrush", "--jobs", 2, "--bench", light_bench_file,
        "--estimator", "pca", "--out", out, "--no-report", "--watch",
    )  # fmt: skip


@pytest.mark.heavy
@pytest.mark.parametrize("program", [RIG, MODULE], ids=["script", "module"])
def test_doctor_over_the_wire_protocol(folder: Path, program: tuple[str, ...]) -> None:
    if program == MODULE:  # Python itself imports some modules from the current folder before it runs ours
        for name in SHADOWED:
            if name not in ("drivers", "fakes", "protocols", "calibration", "cv2", "numpy", "socket"):
                shutil.rmtree(folder / name, ignore_errors=True)
                (folder / f"{name}.py").unlink(missing_ok=True)
    # how good the devices are in real time, and so the exit code, depends on the load of the host
    said = check(
        folder, "doctor", "--bench", "wire", "--seconds", 0.5, "--json", program=program, codes=(0, 1)
    )
    devices = {finding["device"] for finding in json.loads(said)["findings"]}
    assert devices >= {"arm", "gripper", "SIM-D0001", "SIM-D0002", "SIM-C0001"}


def test_every_process_is_started_without_the_current_folder() -> None:
    """A new call that starts Python has to go through drivers.children, or be named here with its reason."""
    reasons = {
        "drivers/children.py": "the one place",
        "rig/experiments/process_pool.py": "forks, which imports nothing",
    }
    starts = (
        "sys.executable",
        "get_context(",
        "multiprocessing.Process(",
        "import_module('multiprocessing')",
    )
    found = {
        str(file.relative_to(ROOT))
        for package in ("rig", "drivers", "fakes", "protocols", "calibration")
        for file in (ROOT / package).rglob("*.py")
        if any(start in file.read_text() for start in starts)
    }
    assert found == set(reasons)
