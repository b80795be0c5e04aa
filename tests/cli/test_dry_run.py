"""`--dry-run` reads every device and shows the whole plan, but moves and stores nothing."""

import json
from pathlib import Path

import pytest

from drivers.bench import Bench
from fakes.devices.arm import FakeArm
from rig.config import load_bench
from rig.config.models import BenchConfig
from rig.config.write import write_bench
from support.command_line import rig

COMMANDS = {
    "trial": (("trial", "--object", "wrench", "--lifts", "2"), "t1/2 wrench"),
    "record": (("record", "--object", "7", "--poses", "2", "--images", "12"), "up to"),
    "camera": (("calibrate", "camera", "--poses", "6"), "006 visited"),
    "hand-eye": (("calibrate", "hand-eye", "--poses", "6"), "006 visited"),
    "markers": (("calibrate", "markers"), "Nothing moves"),
    "references": (("calibrate", "tactile"), "Nothing moves"),
    "presses": (("calibrate", "tactile", "--ball-mm", "5", "--presses", "8"), "ball"),
    "gripper": (("calibrate", "gripper"), "block 95 mm wide"),
    "tcp": (("calibrate", "tcp"), "12 tilted"),
    "sync": (("calibrate", "sync"), "block 30 mm wide"),
}


@pytest.mark.parametrize("name", COMMANDS)
def test_dry_run_moves_nothing_and_stores_nothing(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Bench, "connection", lambda bench: pytest.fail("connected"))
    monkeypatch.setattr(FakeArm, "move_linear", lambda *_: pytest.fail("moved"))
    command, said = COMMANDS[name]
    done = rig(*command, "--dry-run", "--json")
    shown = json.loads(done.stdout)
    assert done.returncode == (2 if shown["refused"] else 0), done.stderr
    assert {finding["device"] for finding in shown["findings"]} == {
        "arm", "gripper", "SIM-D0001", "SIM-D0002", "SIM-C0001",
    }  # fmt: skip
    assert said in "\n".join(shown["plan"])
    assert ("Limits: workspace" in "\n".join(shown["plan"])) != ("Nothing moves" in said)
    assert "nothing was moved" in done.stderr
    assert not list(tmp_path.iterdir())


def test_dry_run_reports_refused_motions_and_unreachable_devices(tmp_path: Path) -> None:
    values = load_bench("wire").model_dump(exclude={"fakes"})
    values["arm"]["host"] = values["gripper"]["host"] = "127.0.0.9"
    values["arm"]["limits"]["max_speed_m_s"] = 0.2
    values["table"]["top_m"] = 0.02
    for sensor in (*values["tactile"], values["camera"]):
        sensor["address"] = "/dev/video98"
    write_bench(tmp_path / "bench.toml", BenchConfig.model_validate(values))
    done = rig("trial", "--object", "wrench", "--lifts", "1", "--bench", tmp_path / "bench.toml", "--dry-run")
    assert done.returncode == 1, done.stderr
    assert "cannot reach 127.0.0.9" in done.stdout
    assert "- arm reached" in done.stdout
    assert "WOULD BE REFUSED: t1/1 wrench: arm: 0.250 m/s is more than 0.2 m/s" in done.stdout
