"""The object files: the largest grip of a reaction to slip."""

import pytest

from drivers.errors import InputError
from fakes.objects.catalogue import find_object
from protocols import grasps
from protocols.grasps import TRIAL_OBJECTS, find_grasp_file
from rig.config.objects import parse_object

STIFFNESS_N_M = 420.0


@pytest.mark.parametrize("object_id", TRIAL_OBJECTS)
def test_largest_grip_of_a_trial_object_exceeds_its_light_grips(object_id: str) -> None:
    grasp_file, model = find_grasp_file(object_id), find_object(object_id)
    largest = grasp_file.require_largest_grip()
    assert largest > max(grasp_file.grip_m)
    swaying_n = 1.2 * STIFFNESS_N_M * largest
    assert model.marked_above_n is None or swaying_n < model.marked_above_n


def test_object_without_largest_grip_is_refused_with_advice() -> None:
    with pytest.raises(InputError, match=r"3 orange.*no largest_grip_mm.*--react stop"):
        find_grasp_file("orange").require_largest_grip()


def test_largest_grip_below_the_light_grips_is_rejected_by_key() -> None:
    text = next(grasps.OBJECTS_FOLDER.glob("t2_*")).read_text()
    with pytest.raises(InputError, match=r"t2\.toml:\d+: largest_grip_mm: .*2\.5 is below grip_mm, 3\.1"):
        parse_object(text.replace("largest_grip_mm = 8.7", "largest_grip_mm = 2.5"), "t2.toml")
