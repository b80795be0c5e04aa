"""A key without effect on a bench is rejected with its line."""

import pytest

from drivers.errors import InputError
from rig.config import BENCHES, BenchConfig
from rig.config.checks import inconsistencies
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
        (FAKE, "[arm]", "tcp_m = [0, 0, 0.25]", "arm.tcp_m: driver 'fake' has only [0.0, 0.0"),
        (FAKE, "[arm]", "tcp_rotation_vector_rad = [0, 0, 0.1]", "arm.tcp_rotation_vector_rad: driver"),
        (FAKE, "[arm]", "limits.max_payload_kg = 4", "arm.limits.max_payload_kg: has no effect"),
        (FAKE, "[gripper]", 'transport = "tcp"', "gripper.transport: has no effect"),
        (FAKE, "[[tactile]]", 'address = "/dev/video0"', "tactile.0.address: has no effect"),
        (FAKE, "[[tactile]]", "size_px = [480, 640]", "tactile.0.size_px: driver 'fake' draws only [240"),
        (FAKE, "[camera]", 'address = "/dev/video0"', "camera.address: has no effect"),
        (FAKE, "[table]", "[fakes]", "fakes: is for the real drivers"),
        (FAKE, "[table]", 'feeder = "magazine"', "table.feeder: is only for real objects"),
        (WIRE, "[table]", 'feeder = "magazine"', "table.feeder: is only for real objects"),
        (FAKE, "[table]", "[calibrations]", "calibrations: must not be in a bench file"),
        (FAKE, "[table]", "[[objects]]", "objects: must not be in a bench file"),
        (FAKE, "[arm]", "limits.stroke_m = 0.1", "arm.limits.stroke_m: has no effect with driver 'fake'"),
        (REAL, "[arm]", "force_sensor = true", "arm.force_sensor: has no effect with driver 'ur5e'"),
        (REAL, "[gripper.limits]", "stroke_m = 0.1", "gripper.limits.stroke_m: has no effect with transport"),
        (REAL, "[[tactile]]", "look_seed = 3", "tactile.0.look_seed: is only for simulated gels"),
        (WIRE, "[arm]", 'host = "192.0.2.1"', "arm.host: does not count: [fakes] starts"),
        (WIRE, "[gripper]", 'host = "192.0.2.1"', "gripper.host: does not count"),
        (WIRE, "[gripper]", "port = 503", "gripper.port: does not count"),
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
    place = f"b.toml:{number}" + (f":{column}" if column > 3 else "")
    assert f"{place}: {said}" in str(refused.value)


def test_network_address_is_rejected_with_a_serial_line() -> None:
    serial = REAL
    for key in ("transport", "preset"):
        serial = serial.replace(f'{key} = "tcp"', f'{key} = "rtu"')
    serial = serial.replace('# device = "ENTER the serial port of the gripper"', 'device = "/dev/ttyUSB0"')
    with pytest.raises(InputError, match=r"(?s)gripper.host: has no effect .* gripper.port: has no effect"):
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
    for text in (FAKE, WIRE, REAL):
        config = parse_bench(text, "b.toml")
        again = BenchConfig.model_validate_json(config.model_dump_json())
        assert again == config
        assert not list(inconsistencies(again))
