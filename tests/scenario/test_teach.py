"""Teaching on the wire bench: the real driver lets go, a scripted hand leads the arm, the fingers measure."""

import json
from pathlib import Path

import pytest

from rig.config.objects import parse_object
from support.command_line import rig

pytest.importorskip("rtde_control", reason="ur-rtde is not installed here")
pytestmark = pytest.mark.real_time

BLOCK = """id = "block"
name = "wide block"
orientations_deg = [0.0]
grip_counts = [2, 4]

[[position]]
name = "middle"   # where it balances
offset_m = 0.02
width_m = 0.11
surface = "flat"
"""


def test_a_position_is_taught_by_hand(tmp_path: Path) -> None:
    (tmp_path / "block.toml").write_text(BLOCK)
    done = rig("teach", "block", "--bench", "wire", "--objects", tmp_path, "--yes", "--json")
    assert done.returncode == 0, done.stderr
    (found,) = json.loads(done.stdout)["positions"]
    assert found["problems"] == []
    assert found["offset_m"] == pytest.approx(0.02, abs=0.005)
    assert found["height_m"] == pytest.approx(0.0, abs=0.005)
    assert found["width_m"] == pytest.approx(0.11, abs=0.003)
    assert found["lift_height_m"] == pytest.approx(0.05, abs=0.008)
    text = (tmp_path / "block.toml").read_text()
    assert parse_object(text, "").position[0].width_m == found["width_m"]
    assert "# where it balances" in text
