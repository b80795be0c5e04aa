"""Packages written by `rig new` can be installed, run, and pass the contract checks."""

import os
import subprocess
import sys
from importlib.metadata import distributions
from pathlib import Path

import pytest

from rig.config.load import parse_bench
from rig.config.write import write_bench
from support.benches import real_bench
from support.command_line import rig
from support.own_devices import OF_OUR_DRIVERS

ROOT = Path(__file__).resolve().parents[2]
LAB = "lab_own"
LEROBOT = "lerobot_camera_lab"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a package of each kind, installed without a network."""
    sources, target = tmp_path_factory.mktemp("sources"), tmp_path_factory.mktemp("site")
    names = {LAB: "lab", LEROBOT: "lerobot"}
    for name, kind in names.items():
        done = rig("new", kind, sources / name)
        assert done.returncode == 0, done.stderr
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-index", "--no-deps", "--no-build-isolation"]
    made = subprocess.run(
        [*pip, "--target", str(target), *(str(sources / name) for name in names)],
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


@pytest.mark.heavy
def test_lerobot_package_is_found_by_its_name(installed: Path) -> None:
    found = {each.metadata["Name"] for each in distributions(path=[str(installed)])}
    assert LEROBOT in found
    assert (installed / f"{LEROBOT}.py").is_file()


SENSOR_IN_LEROBOT = """
from lerobot.cameras import CameraConfig, make_cameras_from_configs
from lerobot.robots import Robot, RobotConfig, make_robot_from_config
from lerobot.utils.import_utils import register_third_party_plugins
from dataclasses import dataclass
import draccus

@RobotConfig.register_subclass("still")
@dataclass(kw_only=True)
class StillConfig(RobotConfig):
    pass

class Still(Robot):
    config_class, name = StillConfig, "still"
    observation_features = action_features = {"joint.pos": float}
    is_connected = is_calibrated = True
    def connect(self, calibrate=True): pass
    def calibrate(self): pass
    def configure(self): pass
    def disconnect(self): pass
    def get_observation(self): return {"joint.pos": 1.0}
    def send_action(self, action): return action

StillConfig.__module__ = "still"
import sys, types
sys.modules["still"] = types.SimpleNamespace(Still=Still)
register_third_party_plugins()
camera = make_cameras_from_configs({"tip": draccus.decode(CameraConfig, {"type": "tactile"})})["tip"]
with camera:
    image, again = camera.async_read(2000.0), camera.read_latest(2000)
    assert image.shape == again.shape == (camera.height, camera.width, 3), image.shape
    assert camera.fps == 60, camera.fps
assert not camera.is_connected
robot = make_robot_from_config(draccus.decode(RobotConfig, {
    "type": "with_touch", "robot": {"type": "still"}, "touch": {"left": {"type": "tactile", "finger": "C"}}}))
robot.connect()
observed = robot.get_observation()
assert observed.keys() == robot.observation_features.keys(), observed.keys()
assert (observed["joint.pos"], observed["left.angle_deg"], observed["left.sigma_deg"]) == (1.0, 0.0, 180.0)
robot.disconnect()
from lerobot.scripts.lerobot_teleoperate import TeleoperateConfig
typed = draccus.parse(TeleoperateConfig, args=[
    "--robot.type=with_touch", "--robot.robot={type: so101_follower, port: none}",
    "--robot.touch={left: {type: tactile, finger: C}}", "--teleop.type=so101_leader", "--teleop.port=none"])
assert typed.robot.touch["left"].fps == 60
assert draccus.decode(RobotConfig, typed.robot.robot).port == "none"
print("done")
"""


@pytest.mark.heavy
def test_sensors_and_angles_reach_lerobot(installed: Path, tmp_path: Path) -> None:
    pytest.importorskip("lerobot", reason="lerobot (with torch) is not installed")
    done = subprocess.run(
        [sys.executable, "-c", SENSOR_IN_LEROBOT], cwd=tmp_path, capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(installed), "HF_HOME": str(tmp_path)}, timeout=240,
    )  # fmt: skip
    assert done.stdout == "done\n", done.stderr


@pytest.mark.heavy
def test_new_packages_pass_the_contract_checks(installed: Path, tmp_path: Path) -> None:
    bench = parse_bench(real_bench(), "file")
    values = bench.model_dump(exclude={"calibrations"}, exclude_unset=True)
    for section, theirs in OF_OUR_DRIVERS.items():
        values[section] = {key: value for key, value in values[section].items() if key not in theirs}
    limits = values["arm"]["limits"]
    without = ("joint_min_deg", "joint_max_deg", "max_contact_force_n")
    values["arm"]["limits"] = {key: value for key, value in limits.items() if key not in without}
    values["arm"]["force_sensor"] = False
    values["arm"]["driver"], values["gripper"]["driver"] = f"{LAB}:LabOwnArm", f"{LAB}:LabOwnGripper"
    values["gripper"]["limits"] = {"max_opening_m": 0.085, "stroke_m": 0.08, "resolution_m": 0.0005}
    for tactile in values["tactile"]:
        tactile["driver"], tactile["options"] = f"{LAB}:LabOwnSensor", {"grey": 100}
    values["camera"]["driver"] = f"{LAB}:LabOwnSensor"
    write_bench(tmp_path / "lab.toml", type(bench).model_validate(values))
    plugin = ("-p", "rig.contract_checks", "-p", "no:cacheprovider")
    checks = ("--pyargs", "rig.contract_checks", "--estimator", "lab-own")
    done = run(installed, tmp_path, "pytest", *plugin, *checks, "--bench", "lab.toml", "--moves")
    assert done.returncode == 0, done.stdout
    assert "failed" not in done.stdout
    # the one that needs a gripper without power
    assert " 1 skipped" in done.stdout, done.stdout


@pytest.mark.parametrize(
    ("kind", "name", "message"),
    [
        ("lab", "My-Gel", "is not a module name"),
        ("lab", "class", "is not a module name"),
        ("lab", "numpy", "exists already"),
        ("lab", "there", "exists already"),
        ("lerobot", "my_gel", "the name must begin with lerobot_camera_"),
    ],
)
def test_invalid_package_name_is_rejected(tmp_path: Path, kind: str, name: str, message: str) -> None:
    (tmp_path / "there").mkdir()
    done = rig("new", kind, tmp_path / name)
    assert done.returncode == 2
    assert message in done.stderr
