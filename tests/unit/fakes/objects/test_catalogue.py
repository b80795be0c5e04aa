"""The simulated bench's objects: complete, plausible, and found by id or name."""

import pytest

from drivers.errors import InputError
from fakes.objects.catalogue import ObjectModel, find_object, load_catalogue

RECORDING = [str(number) for number in range(1, 17)]
TRIAL = [f"t{number}" for number in range(1, 8)]
MOST_LIFTED_KG = 0.22
"""Two fingers of 1.8 N and friction 0.6 carry 2.16 N."""


def test_all_objects_of_the_paper_are_there() -> None:
    assert list(load_catalogue()) == RECORDING + TRIAL


@pytest.mark.parametrize("model", load_catalogue().values(), ids=lambda m: m.name)
def test_object_is_physically_plausible(model: ObjectModel) -> None:
    assert 0.005 <= model.mass_kg <= MOST_LIFTED_KG
    assert 0.6 <= model.friction <= 1.2
    assert 0.0 < model.com_from_left_m < model.length_m < 0.4
    assert len(model.sites) == 3


@pytest.mark.parametrize("model", load_catalogue().values(), ids=lambda m: m.name)
def test_grasp_sites_lie_on_the_object_and_fit_the_gripper(model: ObjectModel) -> None:
    for site in model.sites:
        assert 0.0 < model.com_from_left_m + site.offset_m < model.length_m
        assert 0.001 <= site.width_m <= 0.14
        assert site.offset_m != 0.0


@pytest.mark.parametrize("text", ["t1", "T1", "wrench", " Wrench ", "WRENCH"])
def test_object_is_found_by_id_or_name(text: str) -> None:
    assert find_object(text).id == "t1"


def test_unknown_object_is_answered_with_the_closest_and_with_all() -> None:
    with pytest.raises(InputError, match="did you mean 'wrench'") as caught:
        find_object("wrensh")
    assert all(model.name in str(caught.value) for model in load_catalogue().values())
