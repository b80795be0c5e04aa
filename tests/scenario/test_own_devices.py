"""Lifts with a lab's own drivers over the wire protocols; without [fakes] the bench counts as real.

Without --all, own drivers are tested in `tests/unit/rig/bench/test_own_devices.py` and `tests/contract`.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from fakes.wire.net import Control
from rig.bench.fakes_process import hosted_fakes
from rig.benchmark.wire.campaign import as_real
from rig.config import BenchConfig
from rig.config.write import write_bench
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.sessions.rows import read_finished_lifts
from support.command_line import SHORT_PHASES
from support.own_devices import MODULE, SOURCE
from support.recordings import require_identical_replay
from support.slow_motion import SLOWNESS
from support.waiting import LIMIT_S


def with_own_drivers(bench: BenchConfig) -> BenchConfig:
    """Return the same bench with a user-defined driver for each device, two of them with options."""
    values = as_real(bench).model_dump()
    values["arm"]["driver"] = f"{MODULE}:Wrist"
    registers = {"registers": values["gripper"]["preset"]}
    values["gripper"] |= {"driver": f"{MODULE}:Hand", "options": registers, "preset": None}
    for tip in values["tactile"]:
        tip["driver"] = f"{MODULE}:Finger"
        for drawn in ("markers", "look", "look_seed"):
            del tip[drawn]
    values["tactile"][0]["options"] = {"gel": "hard"}
    values["camera"]["driver"] = f"{MODULE}:Eye"
    return BenchConfig.model_validate(values)


def rig(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run the program in a lab's folder as in a script, without a terminal."""
    return subprocess.run(
        [sys.executable, "-c", SHORT_PHASES, *words], cwd=folder, stdin=subprocess.DEVNULL,
        capture_output=True, text=True, timeout=LIMIT_S, check=False,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip


@pytest.mark.heavy
def test_lift_with_own_drivers_needs_agreement_and_replays_identically(
    tmp_path: Path, unhurried_bench: BenchConfig, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))  # others leave an object in the hand
    (tmp_path / f"{MODULE}.py").write_text(SOURCE)
    command = ["trial", "--lifts", "1", "--object", "wrench", "--bench", "lab.toml", "--no-report"]
    with hosted_fakes(unhurried_bench, None, slowness=SLOWNESS) as (config, _):
        assert config.fakes is not None
        Control(config.fakes.control or "").call("place", object="wrench", seed=3)
        write_bench(tmp_path / "lab.toml", with_own_drivers(config))
        unasked = rig(tmp_path, *command, "--out", "unasked")
        assert unasked.returncode == 3
        assert "no terminal to ask and answer at" in unasked.stderr
        assert not (tmp_path / "unasked").exists()
        agreed = rig(tmp_path, *command, "--out", "agreed", "--yes")
        assert agreed.returncode == 0, agreed.stderr
    (tmp_path / "imported").unlink()
    (row,) = read_finished_lifts(tmp_path / "agreed")
    assert row.simulated is False
    manifest = read_manifest_of(tmp_path / "agreed", TrialManifest, "no trial")
    assert manifest.config.own_drivers == {f"{MODULE}:{name}" for name in ("Wrist", "Hand", "Finger", "Eye")}
    require_identical_replay(tmp_path / "agreed")
    assert not (tmp_path / "imported").exists()
    assert MODULE not in sys.modules
