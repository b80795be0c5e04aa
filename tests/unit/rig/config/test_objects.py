"""A lab's object files: found beside the bench file, and rejected with the line of the error."""

from pathlib import Path

import pytest

from drivers.errors import InputError
from protocols.grasps import OBJECTS_FOLDER, find_grasp_file, grasp_poses
from rig.config import BenchConfig, load_bench
from rig.config.objects import (
    new_object_file,
    objects_folder,
    parse_object,
    read_objects,
    with_more,
    with_objects,
    with_objects_of,
)
from rig.config.write import bench_text

BOX = """id = "box"
name = "cardboard box"
orientations_deg = [0, 15.0]
grip_mm = [1.2, 2.5]

[[position]]
name = "middle"
offset_m = 0.01
width_m = 0.03
lift_height_m = 0.05
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "objects").mkdir()
    (tmp_path / "objects" / "box.toml").write_text(BOX)
    return tmp_path / "objects"


def test_objects_beside_the_bench_file_are_found_by_id_and_name(folder: Path) -> None:
    bench = folder.parent / "bench.toml"
    bench.write_text(bench_text(load_bench("fake")))
    config = with_objects(load_bench(str(bench)), str(bench))
    assert [each.id for each in config.objects] == ["box"]
    assert find_grasp_file(" Cardboard  BOX", config.objects).id == "box"
    assert find_grasp_file("wrench", config.objects).id == "t1"
    with pytest.raises(
        InputError, match=r"unknown object 'boxx' \(did you mean 'box'\?\).*t7 wooden.*box card"
    ):
        find_grasp_file("boxx", config.objects)


def test_given_folder_must_exist_and_a_missing_default_adds_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert objects_folder(str(tmp_path / "bench.toml"), tmp_path) == tmp_path
    with pytest.raises(InputError, match="no such folder"):
        objects_folder("fake", tmp_path / "nowhere")
    monkeypatch.chdir(tmp_path)
    assert with_objects(load_bench("fake"), "fake") == load_bench("fake")
    monkeypatch.chdir(OBJECTS_FOLDER.parent)
    assert objects_folder("fake") is None, "the package's own objects are no lab's"


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("width_m = 0.03", "width_mm = 30", r":9: position.0.width_mm: .*did you mean 'width_m'"),
        ("width_m = 0.03", "width_m = 30.0", r":9: position.0.width_m: .*less than 0.15, found 30.0"),
        ("offset_m = 0.01", 'offset_m = "1 cm"', r":8: position.0.offset_m: .*found '1 cm'"),
        ("[0, 15.0]", "[]", r":3: orientations_deg: has too few entries"),
        ("[1.2, 2.5]", "[2.5, 1.2]", r":4: grip_mm: is not a range from above 0 to 62.5 mm"),
        ("grip_mm = [1.2, 2.5]\n", "", r"grip_mm: is missing"),
        ("2.5]\n", "2.5]\nlargest_grip_mm = 2.0\n", r":5: largest_grip_mm: 2 is below grip_mm, 2.5"),
        ('id = "box"', 'id = "../box"', r":1: id: "),
        ('id = "box"', 'id = "gauge:3"', r":1: id: "),
        ('id = "box"', "id = ", r"not valid TOML: .*line 1"),
        ('name = "cardboard box"\n', "", r"name: is missing"),
        ("[[position]]", BOX[BOX.index("[[position]]") :] + "\n[[position]]", r":6: position: has two"),
    ],
)
def test_invalid_value_is_named_with_file_and_line(folder: Path, old: str, new: str, said: str) -> None:
    assert old in BOX
    (folder / "box.toml").write_text(BOX.replace(old, new))
    with pytest.raises(InputError, match=rf"(?s)box\.toml.*{said}"):
        read_objects(folder)


def test_grips_in_mm_are_steps_of_the_gripper_and_orientations_are_poses() -> None:
    assert [pose.orientation_deg for pose in grasp_poses(parse_object(BOX, "box.toml"))] == [0.0, 15.0]
    spec = load_bench("fake").gripper_spec()
    new = parse_object(BOX.replace("2.5]\n", "2.5]\nlargest_grip_mm = 12.5\n"), "box.toml")
    assert new.grip_m == (0.0012, 0.0025)
    assert [spec.steps_for(grip_m) for grip_m in new.grip_m] == [2, 4]
    assert spec.steps_for(new.require_largest_grip()) == 20


@pytest.mark.parametrize(("key", "value"), [("id", "BOX"), ("id", "wrench"), ("name", "T1"), ("name", "Mug")])
def test_duplicate_object_name_is_rejected_with_both_files(folder: Path, key: str, value: str) -> None:
    unlike = {"id": "crate", "name": "crate", key: value}
    text = BOX.replace('"box"', f'"{unlike["id"]}"').replace('"cardboard box"', f'"{unlike["name"]}"')
    (folder / "crate.toml").write_text(text)
    with pytest.raises(InputError, match=rf"crate\.toml:\d: {key}: '{value.lower()}' .*(box|package)"):
        read_objects(folder)


def test_stored_bench_contains_only_the_objects_it_needs_and_a_bench_file_none(
    tmp_path: Path, folder: Path
) -> None:
    config = with_objects(load_bench("fake"), "fake", folder)
    kept = with_objects_of(config, ["t1", "box"])
    assert BenchConfig.model_validate_json(kept.model_dump_json()).objects == kept.objects == config.objects
    without = with_objects_of(config, ["t1"])
    assert with_more(without, kept.objects).objects == kept.objects
    assert "cardboard" not in bench_text(config)
    file = tmp_path / "bench.toml"
    file.write_text("objects = []\n" + bench_text(config))
    with pytest.raises(InputError, match=":1: objects: must not be in a bench file"):
        load_bench(str(file))


def test_new_object_file_is_valid_and_overwrites_nothing(tmp_path: Path) -> None:
    file = tmp_path / "blue cup (2).toml"
    new_object_file(file)
    made = parse_object(file.read_text(), str(file))
    assert made.id == "blue_cup__2_"
    assert made.position[0].surface is not None
    with pytest.raises(InputError, match="exists already"):
        new_object_file(file)
