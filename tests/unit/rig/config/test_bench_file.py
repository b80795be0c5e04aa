"""Errors in bench files are reported with their line."""

import re
import tomllib
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import InputError
from rig.config import load_bench
from rig.config.load import new_bench_file, parse_bench
from rig.config.messages import line_of
from support.benches import TEMPLATE, filled, real_bench

REAL = real_bench()


def refusal(text: str) -> str:
    with pytest.raises(InputError) as raised:
        parse_bench(text, "b.toml")
    return str(raised.value)


def line_with(text: str, part: str) -> int:
    return next(n for n, line in enumerate(text.splitlines(), 1) if part in line)


def test_template_lists_each_value_to_enter_and_is_a_real_bench_when_filled(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"
    new_bench_file(path)
    with pytest.raises(InputError) as refused:
        load_bench(str(path))
    lines, (head, *listed) = path.read_text().splitlines(), str(refused.value).splitlines()
    assert head == f"{path}: 20 values to enter; nothing was connected"
    to_enter = [n for n, line in enumerate(lines, 1) if "ENTER " in line and not line.startswith("#")]
    for number, line in zip(to_enter, listed, strict=True):
        key, _, rest = lines[number - 1].partition(" = ")
        advice = rest.split('"')[1].removeprefix("ENTER ")
        assert re.fullmatch(rf"{re.escape(str(path))}:{number}: [\w.]*{key}: enter {re.escape(advice)}", line)
        assert len(line.removeprefix(f"{path.parent}/")) <= 100
    examples = ("camera.position_m", "camera.look_at_m", "camera.focal_px", "camera.marker_side_m",
                "gripper.below_tcp_m", "gripper.half_width_m")  # fmt: skip
    assert all(f": {example}: enter " in str(refused.value) for example in examples)
    path.write_text(filled(path.read_text()))
    config = load_bench(str(path))
    assert not config.simulated
    assert config.arm.driver == "ur5e"
    with pytest.raises(InputError, match="exists already"):
        new_bench_file(path)


@pytest.mark.parametrize("sample", ["192.168.1.10", "/dev/ttyUSB0", "/dev/video0", "D20001"])
def test_template_contains_no_address_of_a_device(sample: str) -> None:
    assert sample not in TEMPLATE.read_text()


@pytest.mark.parametrize(
    ("line", "column", "where"),
    [
        ('address = "ENTER a device"', 1, "tactile.0.address"),
        ('options = { port = "ENTER its port" }', 13, "tactile.0.options.port"),
        ('options = { ports = [1, "ENTER its port"] }', 13, "tactile.0.options.ports.1"),
    ],
)
def test_placeholder_in_any_value_is_refused(line: str, column: int, where: str) -> None:
    message = refusal(f'name = "desk"\n[[tactile]]\ndriver = "my.module:Gel"\nserial = "S"\n{line}\n')
    place = "b.toml:5" if column == 1 else f"b.toml:5:{column}"
    assert message.startswith(f"b.toml: 1 value to enter; nothing was connected\n{place}: {where}: enter ")


@pytest.mark.parametrize("name", ["missing.toml", "folder/missing", "./missing"])
def test_missing_bench_file_is_named_as_missing(name: str) -> None:
    with pytest.raises(InputError, match=r"missing.*: there is no such file"):
        load_bench(name)
    with pytest.raises(InputError, match=r"unknown bench 'fakes' .did you mean 'fake'"):
        load_bench("fakes")


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("home_m", "hom_m", "did you mean 'home_m'"),
        ("focal_px = 640.0", "focal_px = 0", "greater than 0, found 0"),
        (
            "focal_px = 640.0",
            "focal_px = 3.6",
            "camera.focal_px: is too short for pictures of size_px: is it in mm",
        ),
        ("frequency_hz = 500", "frequency_hz = nan", "finite"),
        ("max_speed_m_s = 0.5", "max_speed_m_s = 20", "must be at most 1, found 20"),
        ('preset = "tcp"  ', 'preset = "rtu"  ', "must be 'tcp' or 'tcp-2014', found 'rtu'"),
        ('host = "192.0.2.10"', "", "arm.host: is missing: write the controller's address"),
        ('driver = "ur5e"', 'driver = "ur5"', "arm.driver: must be 'fake' or 'ur5e', or a class of your own"),
        ('driver = "ur5e"', "", "arm.driver: is missing: write 'fake' or 'ur5e'"),
        ("[camera]", "[[camera]]", "camera: must be a table, found a list of tables"),
        ("sign = -1", "sign = 1", "signs differ"),
        ("sign = -1", "sign = 0", "1 or -1, found 0"),
        ('serial = "D20002"', 'serial = "D20001"', "another sensor's serial"),
        ('["B", "C"]', '["B", "B"]', "twice"),
        ('["B", "C"]', '["A", "C"]', "exactly one"),
        ("home_m = [0.45, 0.0, 0.30]", "home_m = [4.5, 0.0, 0.30]", "outside the workspace"),
        ("workspace_max_m = [0.75,", "workspace_max_m = [0.05,", "not above workspace_min_m"),
        ('"DICT_4X4_50"', '"DICT_9X9"', "not an ArUco dictionary"),
        ("rate_hz = 30", "rate_hz = 15", "at most 50 ms apart"),
        ("look_at_m = [0.45, 0.0, 0.10]", "look_at_m = [0.45, -0.62, 0.0]", "straight above"),
        ("payload_kg = 2.5", "payload_kg = 5.5", "max_payload_kg"),
        ("port = 502", 'port = "502"', "must be a whole number, found '502'"),
        ("name = ", 'name = ""  # ', "must not be empty"),
        ('host = "192.0.2.10"', 'host = "http://arm:80"', "arm.host"),
        ("marker_ids = [0, 1]", "marker_ids = [0, 50]", "markers 0 to 49"),
        ("marker_ids = [0, 1]", "marker_ids = [-1, 1]", "must be at least 0"),
        ("tcp_m = [0.0, 0.0, 0.28]", "tcp_m = [0.0, 0.0, 280.0]", "must be at most 1"),
        ("tcp_m = [0.0, 0.0, 0.28]", "tcp_m = [0.0, 0.28]", "arm.tcp_m: has only 2 of its entries"),
        ("joint_max_deg = [360,", "joint_max_deg = [720,", "must be at most 360"),
        ("home_m = [0.45, 0.0, 0.30]", "home_m = [0.45, 0.0, 0.05]", "not above position_m"),
        ("home_m = [0.45, 0.0, 0.30]", "home_m = 2026-01-01", "must be a list, found '2026-01-01'"),
    ],
)
def test_invalid_values_and_unknown_keys_are_rejected(old: str, new: str, said: str) -> None:
    assert old in REAL
    message = refusal(REAL.replace(old, new, 1))
    assert said in message
    assert re.match(r"b\.toml:\d+: |b\.toml: \d+ faults\nb\.toml:\d+: ", message)
    assert not re.search(r"Input|Field|column|class '|tuple|\bdict\b", message)


LIMITS = [
    "workspace_min_m", "workspace_max_m", "max_speed_m_s", "max_acceleration_m_s2", "max_payload_kg",
    "max_contact_force_n",
]  # fmt: skip


@pytest.mark.parametrize("key", ["tcp_m", "payload_kg", "payload_cog_m", *LIMITS])
def test_real_bench_requires_controller_settings_and_limits(key: str) -> None:
    kept = "\n".join(line for line in REAL.splitlines() if not line.startswith(f"{key} ="))
    where = "arm.limits" if key in LIMITS else "arm"
    place = f"b.toml:{line_with(kept, f'[{where}]')}: {where}.{key}"
    assert re.search(rf"{re.escape(place)}: is missing: write .*, as \[?[\d.]+", refusal(kept))


def test_real_bench_requires_the_table_height_and_lists_missing_limits() -> None:
    kept = "\n".join(line for line in REAL.splitlines() if not line.startswith("top_m ="))
    assert "table.top_m: is missing: write the height of the table's top" in refusal(kept)
    head, _, rest = REAL.partition("[arm.limits]")
    _, _, tail = rest.partition("[gripper]")
    message = refusal(f"{head}[gripper]{tail}")
    assert f"arm.limits: is missing: write [arm.limits] with {', '.join(LIMITS)}" in message


def test_every_fault_has_its_line_and_more_than_twenty_are_counted() -> None:
    wrong = "\n".join(f"wrong_{n} = 1" for n in range(25))
    head, *lines, last = refusal(f"{wrong}\n{REAL}").splitlines()
    assert (head, last) == ("b.toml: 25 faults", "b.toml: and 5 more faults")
    assert [line.split(": ")[0] for line in lines] == [f"b.toml:{n + 1}" for n in range(20)]


def test_keep_out_boxes_grow_by_the_size_of_the_hand() -> None:
    text = REAL + '[[keep_out]]\nname = "stand"\nmin_m = [0.4, -0.7, 0.0]\nmax_m = [0.5, -0.6, 0.4]\n'
    stand, table = parse_bench(text, "b.toml").arm_limits().keep_out
    assert stand.name == "stand"
    assert stand.min_m == pytest.approx((0.3, -0.8, -0.28))
    assert stand.max_m == pytest.approx((0.6, -0.5, 0.415))
    assert table.max_m[2] == pytest.approx(0.035)


def test_error_names_the_line_of_the_key() -> None:
    head, _, tail = REAL.rpartition("rate_hz = 60")
    second = f"{head}rate_hz = 59{tail}"
    assert refusal(second).startswith(f"b.toml:{line_with(second, 'rate_hz = 59')}: tactile.1.rate_hz: ")
    of_many = REAL.replace("size_px = [640, 480]", "size_px = [\n  640,  # wide\n  -1,\n]")
    assert f"b.toml:{line_with(of_many, 'wide') - 1}: camera.size_px.1" in refusal(of_many)
    assert "line 3" in refusal("a = 1\n\nb = = 2\n")
    missing = REAL.replace('serial = "camera"', "# none")
    assert f"b.toml:{line_with(missing, '[camera]')}: camera.serial" in refusal(missing)


KEYS = st.from_regex(r"[a-z]{1,6}", fullmatch=True)
VALUES = st.sampled_from(["1", '"x"', "[\n 1,\n 2,\n]", '"""a\nb = 3\n"""', "{ k = 1 }", "true # k = 2"])


@given(st.dictionaries(KEYS, st.dictionaries(KEYS, VALUES, min_size=1, max_size=4), min_size=1, max_size=4))
def test_line_of_every_key_is_found(tables: dict[str, dict[str, str]]) -> None:
    lines: list[str] = []
    where: dict[tuple[str, str], int] = {}
    for table, keys in tables.items():
        lines += ["# comment", f"[{table}]"]
        for key, value in keys.items():
            where[table, key] = len(lines) + 1
            lines += f"{key} = {value}".splitlines()
    text = "\n".join(lines)
    tomllib.loads(text)
    assert {path: line_of(text, path) for path in where} == where
