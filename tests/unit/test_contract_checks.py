"""The contract checks, run as a lab runs them: in a separate folder, on a lab's own class."""

import subprocess
import sys
from pathlib import Path

import pytest

WRONG = """
from dataclasses import replace

from rig.tactile.estimators import choose_estimator


class Clockwise:
    def __init__(self, background):
        self.inner = choose_estimator("pca", 1).make(background)

    def update(self, image, time_ns):
        sample = self.inner.update(image, time_ns)
        return replace(sample, angle_deg=sample.angle_deg and -sample.angle_deg)
"""
PLUGIN = ("-p", "rig.contract_checks")
CHECKS = ("-p", "no:cacheprovider", "--pyargs", "rig.contract_checks")


def pytest_of(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pytest", *words]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120, check=False)


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    (tmp_path / "lab_wrong.py").write_text(WRONG)
    return tmp_path


@pytest.mark.heavy
def test_contract_violation_of_an_estimator_is_reported_and_devices_are_skipped_without_a_bench_file(
    lab: Path,
) -> None:
    few = ("-k", "clockwise or changed_frame_size or TestArm or TestFrames or TestGripper", "-rs")
    done = pytest_of(lab, *PLUGIN, *CHECKS, "--estimator", "lab_wrong:Clockwise", *few)
    assert done.returncode == 1, done.stdout + done.stderr
    assert "the true rotation is 20: check sign and unit" in done.stdout
    assert "1 failed, 1 passed" in done.stdout
    assert "give --bench FILE, and --moves to let it move" in done.stdout


@pytest.mark.heavy
def test_checks_of_devices_that_the_bench_file_lacks_are_skipped(lab: Path) -> None:
    (lab / "desk.toml").write_text('name = "desk"\n[[tactile]]\ndriver = "digit"\nserial = "D1"\n')
    words = ("--bench", "desk.toml", "--moves", "-k", "TestArm or TestGripper", "-rs")
    done = pytest_of(lab, *PLUGIN, *CHECKS, *words)
    assert done.returncode == 0, done.stdout
    assert "the bench file has no such device" in done.stdout
    assert "passed" not in done.stdout
