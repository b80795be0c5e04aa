"""Benches that lack parts, or mix simulated and real devices: rejected files, needs of commands."""

import re
from itertools import combinations
from pathlib import Path

import pytest

from drivers.errors import InputError
from rig.config import BENCHES, BenchConfig, load_bench
from rig.config.load import parse_bench
from rig.config.parts import NEEDS, require_parts, working
from rig.config.write import bench_text
from support.benches import real_bench
from support.command_line import rig

FAKE = (BENCHES / "fake.toml").read_text()
REAL = real_bench()
DESK = 'name = "desk"\n[[tactile]]\ndriver = "digit"\nserial = "D20641"\n'
DIGITS = FAKE.replace('[[tactile]]\ndriver = "fake"', '[[tactile]]\ndriver = "digit"')
CAMERA = FAKE.replace('[camera]\ndriver = "fake"', '[camera]\ndriver = "camera"\naddress = "/dev/video4"')
HEAD, FIRST_TIP, REST = FAKE.split("[[tactile]]")
ONE_TIP = f"{HEAD}[[tactile]]{FIRST_TIP}[camera]{REST.partition('[camera]')[2]}"
SECTIONS = ("arm", "gripper", "tactile", "camera")
ARGUMENTS = {
    "rig record": ("--object", "7"),
    "rig record --by hand": ("--object", "7"),
    "rig teach": ("7",),
    "rig calibrate tactile --ball-mm": ("9.5",),
}
"""What the commands of `NEEDS` need on the command line besides a bench."""


def without(*sections: str, text: str = FAKE) -> BenchConfig:
    """Read a bench file without the tables of these names; [table] goes with the arm."""
    gone = {*sections, *(["table", "arm.limits"] if "arm" in sections else [])}
    gone |= {"gripper.limits"} if "gripper" in sections else set()
    kept, keep = [], True
    for line in text.splitlines():
        if line.startswith("["):
            keep = line.strip("[] ").partition("]")[0] not in gone
        if keep and not ("arm" in sections and line.startswith("reactions_allowed")):
            kept.append(line)
    return parse_bench("\n".join(kept), "b.toml")


def refusal(text: str) -> str:
    with pytest.raises(InputError) as raised:
        parse_bench(text, "b.toml")
    return str(raised.value)


def test_one_sensor_is_a_bench_whose_missing_sections_are_named() -> None:
    config = parse_bench(DESK, "b.toml")
    assert [t.serial for t in config.tactile] == ["D20641"]
    assert not config.simulated
    assert config.drivers == {"digit"}
    assert not config.has("arm")
    with pytest.raises(InputError, match=r"bench 'desk' has no \[arm\]: add it to the bench file"):
        config.require("arm")
    assert BenchConfig.model_validate(config.model_dump(mode="json")) == config
    for text in (DESK, DIGITS):
        assert parse_bench(bench_text(parse_bench(text, "b.toml")), "b.toml") == parse_bench(text, "b.toml")


def test_each_command_that_one_sensor_cannot_serve_lists_the_missing_sections() -> None:
    config = parse_bench(DESK, "b.toml")
    whole, calibrate = "[arm], [gripper], two [[tactile]] and [camera]", "rig calibrate"
    wanted = dict.fromkeys(("rig trial", "rig record", "rig teach", f"{calibrate} gripper"), whole)
    wanted |= {f"{calibrate} tactile --ball-mm": whole, f"{calibrate} tcp": "[arm] and [gripper]"}
    wanted |= {f"{calibrate} hand-eye": "[arm], [gripper] and [camera]"}
    wanted |= dict.fromkeys((f"{calibrate} {kind}" for kind in ("camera", "markers", "sync")), "[camera]")
    works = ["rig doctor", "rig live", "rig record --by hand", f"{calibrate} tactile"]
    assert [*working(config)] == works
    assert {*wanted} == {*NEEDS} - {*works}
    for command, needs in wanted.items():
        with pytest.raises(InputError, match=re.escape(f"{command} needs {needs}, which bench 'desk' lacks")):
            require_parts(config, command)


@pytest.mark.parametrize("text", [FAKE, REAL], ids=["fake", "real"])
def test_any_devices_but_not_all_may_be_missing_and_a_written_bench_reads_back_the_same(text: str) -> None:
    for gone in (g for n in (0, 1, 2, 3) for g in combinations(SECTIONS, n)):
        config = without(*gone, text=text)
        assert {str(where[0]) for where, _ in config.devices} == {*SECTIONS} - {*gone}
        if len(gone) <= 1:
            assert parse_bench(bench_text(config), "b.toml") == config


@pytest.mark.parametrize(
    ("config", "part"),
    [
        (without("arm"), "[arm]"),
        (without("gripper"), "[gripper]"),
        (without("tactile"), "[[tactile]]"),
        (without("camera"), "[camera]"),
        (parse_bench(ONE_TIP, "b.toml"), "two [[tactile]]"),
        (parse_bench(DIGITS, "b.toml"), "[arm]"),
        (parse_bench(CAMERA, "b.toml"), "[arm]"),
    ],
    ids=[*SECTIONS, "second fingertip", "real fingertips", "real camera"],
)
def test_commands_are_refused_exactly_on_a_bench_without_a_part_that_they_need(
    config: BenchConfig, part: str, tmp_path: Path
) -> None:
    file = tmp_path / "b.toml"
    file.write_text(bench_text(config))
    refused = [command for command, needs in NEEDS.items() if any(part in need for need in needs)]
    allowed = [command for command in NEEDS if command not in refused]
    said = f"{part}, which bench 'fake' lacks: add it to the bench file (rig bench new FILE"
    if config.mixed:
        said = "moves the arm, and bench 'fake' has simulated devices"
    assert [*working(config)] == allowed
    for command in allowed:
        require_parts(config, command)
    for command in refused:
        shown = rig(*command.split()[1:], *ARGUMENTS.get(command, ()), "--bench", file)
        before, found, _ = shown.stderr.partition(said)
        assert (shown.returncode, found) == (2, said)
        assert command.removesuffix(" --ball-mm") in before
        assert shown.stderr.strip().endswith(f", these work: {', '.join(allowed)}")


def test_whole_bench_serves_every_command() -> None:
    for whole in (*map(load_bench, ("fake", "hard", "wire")), parse_bench(REAL, "b.toml")):
        assert [*working(whole)] == [*NEEDS]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (DESK, 'name = "desk"\n', "has no device"),
        ("[[tactile]]\n", "[[tactile]]\naddres = 1\n", "did you mean 'address'"),
        ('serial = "D20641"\n', "", "tactile.0.serial: is missing"),
        ('"D20641"\n', '"D20641"\n[fakes]\n', "fakes: supports only complete benches"),
        ('name = "desk"\n', 'name = "desk"\nreactions_allowed = true\n', "is for benches with an arm"),
        (
            '"D20641"\n',
            '"D20641"\n[[tactile]]\ndriver = "digit"\nserial = "D2"\n',
            "exactly one [[tactile]] for each",
        ),
        (
            '"D20641"\n',
            '"D20641"\n[[tactile]]\ndriver = "fake"\nserial = "S"\nfinger = "B"\n',
            "one fingertip is 'fake' and the other is not",
        ),
    ],
)
def test_invalid_bench_of_one_sensor_is_refused(old: str, new: str, said: str) -> None:
    assert said in refusal(DESK.replace(old, new, 1))


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("position_m = [0.45, -0.62", "camera.position_m: is needed beside [arm]"),
        ("look_at_m", "camera.look_at_m: is needed beside [arm]"),
        ('finger = "B"', "tactile.0.finger: is needed beside [gripper]"),
        ("sign = -1", "tactile.1.sign: is needed beside [gripper]"),
    ],
)
def test_key_needed_beside_another_device_is_required(line: str, said: str) -> None:
    for text in (FAKE, REAL):
        assert said in refusal("\n".join(each for each in text.splitlines() if not each.startswith(line)))


def test_arm_needs_the_table_and_its_limits_also_without_a_gripper() -> None:
    assert "table: is needed beside [arm]" in refusal(FAKE.partition("[table]")[0])
    text = "\n".join(line for line in REAL.splitlines() if not line.startswith("max_contact_force_n"))
    with pytest.raises(InputError, match=r"arm\.limits\.max_contact_force_n: is missing: write"):
        without("gripper", "tactile", "camera", text=text)


@pytest.mark.parametrize("fake", SECTIONS)
def test_real_arm_or_gripper_beside_any_simulated_device_is_refused(fake: str) -> None:
    # a simulated bench asks no questions, needs no limits and may react to slip, so it must not move real
    # devices
    kept = [
        table for table in REAL.split("\n[") if not table.lstrip("[").startswith((f"{fake}]", f"{fake}."))
    ]
    simulated = [table for table in FAKE.split("\n[") if table.lstrip("[").startswith(f"{fake}]")]
    message = refusal("\n[".join([*kept, *simulated]))
    for kind in {"arm", "gripper"} - {fake}:
        assert f"{kind}.driver: is real and would react to data of simulated devices" in message


def test_data_are_simulated_if_their_own_device_is() -> None:
    mixed = parse_bench(DIGITS, "b.toml")
    fault = '\n[[faults]]\ndevice = "arm"\nkind = "drop"\nat_s = 1.0\n'
    assert "faults: work only if all devices are simulated in" in refusal(DIGITS + fault)
    assert not mixed.gives_simulated("SIM-D0001")
    assert mixed.gives_simulated("SIM-C0001")
    assert mixed.gives_simulated("arm")
    assert mixed.simulated
    assert not mixed.fingertips_alone().simulated
    for name in ("fake", "wire"):
        assert load_bench(name).gives_simulated("SIM-D0001")
        assert load_bench(name).fingertips_alone().simulated
    assert not parse_bench(REAL, "b.toml").gives_simulated("D20001", "D20002", "camera", "arm", "gripper")
