"""A key without effect on a bench is rejected with its line, but never in a session's stored copy."""

import pytest

from drivers.errors import InputError
from rig.config import BENCHES, BenchConfig
from rig.config.checks import unused_keys
from rig.config.load import parse_bench
from support.benches import real_bench

FAKE, WIRE = ((BENCHES / f"{name}.toml").read_text() for name in ("fake", "wire"))
REAL = real_bench()


def after(text: str, head: str, line: str) -> str:
    """Insert a line after the first one that begins with `head`."""
    assert f"\n{head}" in text
    before, _, rest = text.partition(f"\n{head}")
    first, _, rest = rest.partition("\n")
    return f"{before}\n{head}{first}\n{line}\n{rest}"


@pytest.mark.parametrize(
    ("text", "head", "line", "said"),
    [
        (FAKE, "[arm]", 'host = "192.0.2.1"', "arm.host: has no effect with driver 'fake'"),
        (FAKE, "[arm]", "frequency_hz = 125", "arm.frequency_hz: has no effect"),
        (FAKE, "[arm]", "payload_kg = 2.0", "arm.payload_kg: has no effect"),
        (FAKE, "[arm]", "payload_cog_m = [0, 0, 0.1]", "arm.payload_cog_m: has no effect"),
        (FAKE, "[arm]", "tcp_m = [0, 0, 0.25]", "arm.tcp_m: the hand of driver 'fake' has only [0.0, 0.0"),
        (FAKE, "[arm]", "tcp_rotation_vector_rad = [0, 0, 0.1]", "arm.tcp_rotation_vector_rad: the hand"),
        (FAKE, "[arm]", "limits.max_payload_kg = 4", "arm.limits.max_payload_kg: has no effect"),
        (FAKE, "[gripper]", 'transport = "tcp"', "gripper.transport: has no effect"),
        (FAKE, "[gripper]", 'host = "192.0.2.1"', "gripper.host: has no effect"),
        (FAKE, "[gripper]", "port = 502", "gripper.port: has no effect"),
        (FAKE, "[gripper]", 'device = "/dev/ttyUSB0"', "gripper.device: has no effect"),
        (FAKE, "[gripper]", 'preset = "tcp"', "gripper.preset: has no effect"),
        (FAKE, "[[tactile]]", 'address = "/dev/video0"', "tactile.0.address: has no effect"),
        (FAKE, "[[tactile]]", "size_px = [480, 640]", "tactile.0.size_px: driver 'fake' draws only [240"),
        (FAKE, "[camera]", 'address = "/dev/video0"', "camera.address: has no effect"),
        (FAKE, "[table]", "[fakes]", "fakes: is for the real drivers"),
        (FAKE, "[table]", 'feeder = "magazine"', "table.feeder: is only for real objects"),
        (WIRE, "[table]", 'feeder = "magazine"', "table.feeder: is only for real objects"),
        (FAKE, "[table]", "[calibrations]", "calibrations: must not be in a bench file"),
        (WIRE, "[arm]", 'host = "192.0.2.1"', "arm.host: does not count: [fakes] starts"),
        (WIRE, "[gripper]", 'host = "192.0.2.1"', "gripper.host: does not count"),
        (WIRE, "[gripper]", "port = 502", "gripper.port: does not count"),
        (WIRE, "[[tactile]]", 'address = "/dev/video0"', "tactile.0.address: does not count"),
        (WIRE, "[camera]", 'address = "/dev/video0"', "camera.address: does not count"),
        (REAL, "[gripper]", 'device = "/dev/ttyUSB0"', "gripper.device: has no effect with transport 'tcp'"),
        (REAL, "[[tactile]]", "markers = true", "tactile.0.markers: is only for simulated gels"),
        (REAL, "name", 'difficulty = "hard"', "difficulty: is only for simulated lifts"),
    ],
)
def test_key_without_effect_is_rejected_with_its_line(text: str, head: str, line: str, said: str) -> None:
    # [table] and what follows it are written behind the last table's keys
    changed = (
        after(text, "position_m = [0.45, 0.0, 0.06]", line) if head == "[table]" else after(text, head, line)
    )
    number = changed.splitlines().index(line) + 1
    with pytest.raises(InputError) as refused:
        parse_bench(changed, "b.toml")
    column = line.index(said.partition(":")[0].rpartition(".")[2]) + 1
    assert f"line {number}, column {column}: {said}" in str(refused.value)


def test_network_address_is_rejected_with_a_serial_line() -> None:
    serial = REAL
    for key in ("transport", "preset"):
        serial = serial.replace(f'{key} = "tcp"', f'{key} = "rtu"')
    serial = serial.replace('# device = "ENTER the serial port of the gripper"', 'device = "/dev/ttyUSB0"')
    with pytest.raises(InputError, match=r"gripper.host: has no effect .* gripper.port: has no effect"):
        parse_bench(serial, "b.toml")
    kept = [
        line for line in serial.splitlines() if not line.startswith(("port = 502", 'host = "192.0.2.11"'))
    ]
    assert parse_bench("\n".join(kept), "b.toml").gripper.device == "/dev/ttyUSB0"


def test_keys_at_their_fixed_value_and_limits_and_markers_of_a_simulated_bench_are_accepted() -> None:
    said = after(after(FAKE, "[arm]", "tcp_m = [0.0, 0.0, 0.28]"), "[[tactile]]", "size_px = [240, 320]")
    assert parse_bench(said, "b.toml") == parse_bench(FAKE, "b.toml")
    text = after(after(FAKE, "[arm]", "limits.max_speed_m_s = 0.3"), "[gripper]", "limits.max_counts = 230")
    config = parse_bench(after(text, "[[tactile]]", "markers = true"), "b.toml")
    assert (config.arm.limits.max_speed_m_s, config.gripper.limits.max_counts) == (0.3, 230)
    assert config.tactile[0].markers
    assert parse_bench(after(WIRE, "[[tactile]]", "markers = true"), "b.toml").tactile[0].markers


def test_stored_copy_with_every_key_is_accepted() -> None:
    stored = parse_bench(FAKE, "b.toml").model_dump(mode="json")
    again = BenchConfig.model_validate(stored)
    assert again == parse_bench(FAKE, "b.toml")
    # such a copy is no file: held against the rule for files it would be refused
    assert list(unused_keys(again))
