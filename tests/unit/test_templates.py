"""What `rig new` writes: packages that install into a folder of their own, run, and keep the contract."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from rig.config import load_bench
from rig.config.write import write_bench
from support.command_line import rig

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
KINDS = ("estimator", "sensor", "camera", "arm", "gripper")


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the five packages, `lab_arm` and the like, installed without a network."""
    sources, target = tmp_path_factory.mktemp("sources"), tmp_path_factory.mktemp("site")
    for kind in KINDS:
        done = rig("new", kind, sources / f"lab_{kind}")
        assert done.returncode == 0, done.stderr
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-index", "--no-deps", "--no-build-isolation"]
    made = subprocess.run(
        [*pip, "--target", str(target), *(str(sources / f"lab_{kind}") for kind in KINDS)],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
    return target


def run(installed: Path, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a module of Python's with the packages beside the rig's."""
    return subprocess.run(
        [sys.executable, "-m", *words], cwd=folder, capture_output=True, text=True, timeout=240, check=False,
        env={**os.environ, "PYTHONPATH": str(installed)},
    )  # fmt: skip


def test_new_packages_install_and_are_listed(installed: Path, tmp_path: Path) -> None:
    files = {path.name for path in installed.iterdir()}
    assert {f"lab_{kind}.py" for kind in KINDS} <= files
    assert {f"lab_{kind}-0.1.dist-info" for kind in KINDS} <= files
    listed = json.loads(run(installed, tmp_path, "rig", "estimators", "--json").stdout)["estimators"]
    assert {
        "name": "lab-estimator",
        "from": "lab-estimator 0.1",
        "class": "lab_estimator:LabEstimator",
    } in listed


@pytest.mark.real_time
@pytest.mark.long
def test_new_packages_pass_the_contract_checks(installed: Path, tmp_path: Path) -> None:
    bench = load_bench(str(ROOT / "rig" / "config" / "new_bench.toml"))
    values = bench.model_dump(exclude={"calibrations"}, exclude_unset=True)
    for section, theirs in NOT_TAKEN.items():
        values[section] = {key: value for key, value in values[section].items() if key not in theirs}
    limits = values["arm"]["limits"]
    values["arm"]["limits"] = {key: value for key, value in limits.items() if "joint" not in key}
    values["arm"]["force_sensor"] = False
    values["arm"]["driver"], values["gripper"]["driver"] = "lab_arm:LabArm", "lab_gripper:LabGripper"
    values["gripper"]["limits"] = {"max_opening_m": 0.085, "stroke_m": 0.08, "resolution_m": 0.0005}
    for tactile in values["tactile"]:
        tactile["driver"], tactile["options"] = "lab_sensor:LabSensor", {"grey": 100}
    values["camera"]["driver"] = "lab_camera:LabCamera"
    write_bench(tmp_path / "lab.toml", type(bench).model_validate(values))
    plugin = ("-p", "rig.contract_checks.options", "-p", "no:cacheprovider")
    checks = ("--pyargs", "rig.contract_checks", "--estimator", "lab-estimator")
    done = run(installed, tmp_path, "pytest", *plugin, *checks, "--bench", "lab.toml", "--moves")
    assert done.returncode == 0, done.stdout
    assert "failed" not in done.stdout
    # the one that needs a gripper without power
    assert " 1 skipped" in done.stdout, done.stdout


NOT_TAKEN = {
    "arm": ("host", "frequency_hz"),
    "gripper": ("transport", "host", "port", "preset"),
    "camera": ("address",),
}


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("My-Gel", "is no name of a module"),
        ("class", "is no name of a module"),
        ("numpy", "is here already"),
        ("there", "exists already"),
    ],
)
def test_invalid_package_name_is_rejected(tmp_path: Path, name: str, says: str) -> None:
    (tmp_path / "there").mkdir()
    done = rig("new", "sensor", tmp_path / name)
    assert done.returncode == 2
    assert says in done.stderr
