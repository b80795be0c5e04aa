"""Commands in an installation without extras."""

import subprocess
from pathlib import Path

import pytest

from drivers.children import python_command
from drivers.errors import InputError
from drivers.robotiq_3f.modbus import rtu_link, tcp_link
from rig.config.extras import WIRE

CODE = (
    f"import sys; sys.modules.update(dict.fromkeys({[*WIRE, 'pytest', 'hypothesis']}))\n"
    "from rig.cli.main import main; main()"
)


def rig_without_extras(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = python_command("-c", CODE, *arguments)
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.heavy
@pytest.mark.parametrize(
    "arguments",
    [("trial", "--bench", "wire", "--lifts", "1", "--object", "7"), ("fakes", "serve", "--write", "f.toml")],
)
def test_wire_bench_without_its_libraries_names_the_line_that_installs_them(
    arguments: tuple[str, ...], tmp_path: Path
) -> None:
    done = rig_without_extras(tmp_path, *arguments)
    assert done.returncode == 2
    assert done.stderr.endswith('needs pymodbus: pip install "visuotactile-slip-rig[bench]"\n')


@pytest.mark.heavy
def test_simulated_bench_needs_no_extra(tmp_path: Path) -> None:
    done = rig_without_extras(tmp_path, "trial", "--lifts", "1", "--object", "7", "--dry-run")
    assert (done.returncode, "nothing was moved" in done.stderr) == (0, True), done.stderr


def test_gripper_without_pymodbus_names_the_line_that_installs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.robotiq_3f.modbus.find_spec", lambda name: None)
    for link, address in ((tcp_link, "192.0.2.1"), (rtu_link, "/dev/ttyUSB0")):
        with pytest.raises(InputError, match=r"pymodbus is not installed: pip install .*\[bench\]"):
            link(address)
