"""Taught values are written into an object file's text: comments stay, unsupported files are rejected."""

import pytest

from drivers.errors import InputError
from rig.config.objects import new_object_text, parse_object, with_position

VALUES = {"offset_m": -0.0512, "height_m": 0.003, "turn_deg": 2.5, "width_m": 0.0287, "lift_height_m": 0.044}


def test_values_change_and_comments_stay() -> None:
    text = new_object_text("box")
    changed, read = with_position(text, "middle", VALUES, "box.toml")
    assert {key: getattr(read.position[0], key) for key in VALUES} == VALUES
    assert read.position[0].surface == "edge"
    before, after = (t.splitlines() for t in (text, changed))
    assert [line for line in before if line.lstrip().startswith("#")] == [
        line for line in after if line.lstrip().startswith("#")
    ]
    assert "width_m = 0.0287                     # distance between the fingertips" in changed
    assert len(after) == len(before) + 2, "height_m and turn_deg were not there"
    assert with_position(changed, "middle", VALUES, "box.toml")[0] == changed


def test_named_position_is_changed() -> None:
    text = new_object_text("box") + '\n[[position]]\nname = "end" # of it\noffset_m = 0.1\nwidth_m = 0.02\n'
    _, read = with_position(text, "end", {"offset_m": 0.2, "width_m": 0.03}, "box.toml")
    assert [(p.name, p.offset_m, p.width_m) for p in read.position] == [
        ("middle", 0.03, 0.03),
        ("end", 0.2, 0.03),
    ]


def test_new_position_is_inserted_after_the_others_and_before_other_tables() -> None:
    text = new_object_text("box") + "[simulated]\nmass_kg = 0.05\n"
    changed, read = with_position(text, "left", VALUES, "box.toml")
    assert [p.name for p in read.position] == ["middle", "left"]
    assert read.simulated.mass_kg == 0.05
    assert parse_object(changed, "box.toml") == read


def test_file_with_inline_tables_is_rejected() -> None:
    text = (
        'id = "box"\nname = "box"\norientations_deg = [0]\ngrip_mm = [1.2, 2.5]\n'
        'position = [{ name = "middle", offset_m = 0.0, width_m = 0.03 }]\n'
    )
    with pytest.raises(InputError, match=r"box.toml"):
        with_position(text, "middle", VALUES, "box.toml")
