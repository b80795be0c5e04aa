"""Plain shapes: what the simulated bench lays down for an object that it has no twin of."""

import numpy as np
import pytest

from drivers.errors import InputError
from fakes.objects.catalogue import PREFIX, find_object, short_id
from fakes.objects.surfaces import build_surface
from protocols.grasps import GraspFile
from rig.bench.twins import laid_as, plain_notes, refuse_undrawn
from rig.config import load_bench

VALUES = {
    "id": "box",
    "name": "cardboard box",
    "orientations_deg": [0.0],
    "grip_mm": [1.2, 2.5],
    "position": [{"name": "left", "offset_m": -0.04, "width_m": 0.03, "surface": "edge"}],
    "simulated": {"mass_kg": 0.05},
}


def own(**position: object) -> GraspFile:
    return GraspFile.model_validate({**VALUES, "position": [{**VALUES["position"][0], **position}]})  # type: ignore[index]


def test_an_object_becomes_a_shape_of_its_width_where_it_is_grasped() -> None:
    model = find_object(laid_as([own()], "box"))
    assert (model.name, model.mass_kg, model.friction, model.com_from_left_m) == (
        "cardboard box",
        0.05,
        0.8,
        0.1,
    )
    assert [(site.offset_m, site.width_m) for site in model.sites] == [(-0.04, 0.03)]
    assert short_id(model.id) == "box"
    assert find_object(model.id) is model, "the same text is the same object, in any process"


def test_each_surface_is_another_shape() -> None:
    heights = [
        build_surface(find_object(laid_as([own(surface=surface)], "box")).sites[0], 1, 0).height_mm
        for surface in ("edge", "flat", "cylinder", "ball")
    ]
    for i, first in enumerate(heights):
        assert all(np.abs(first - other).max() > 0.5 for other in heights[i + 1 :])


def test_an_object_of_the_catalogue_is_its_twin() -> None:
    assert laid_as([own()], "t1") == "t1"
    assert laid_as([own()], "gauge:30") == "gauge:30"


def test_one_without_a_surface_is_refused_where_it_would_be_drawn() -> None:
    fake, wire = (
        load_bench(name).model_copy(update={"objects": (own(surface=None),)}) for name in ("fake", "wire")
    )
    for bench in (fake, wire):
        with pytest.raises(
            InputError, match=r"no simulated twin, .* no surface at 'left'.*surface = \"flat\""
        ):
            refuse_undrawn(bench, bench.objects[0])
    real = wire.model_copy(update={"fakes": None})
    refuse_undrawn(real, real.objects[0])


def test_what_is_taken_for_true_of_it_is_said_on_simulated_benches_alone() -> None:
    bench = load_bench("wire").model_copy(update={"objects": (own(),)})
    (note,) = plain_notes(bench, bench.objects)
    assert note.startswith("SIMULATED: object box")
    assert "left edge 30 mm; 0.05 kg, friction 0.8, 200 mm long" in note
    assert plain_notes(bench.model_copy(update={"fakes": None}), bench.objects) == []


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"sites": 1}', "{" * 9000, '{"sites": [{"surface": "fur"}]}']
)
def test_a_text_that_describes_nothing_is_an_input_error(text: str) -> None:
    with pytest.raises(InputError, match="not a plain object"):
        find_object(PREFIX + text)
