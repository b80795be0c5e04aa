"""Contact masks: the shipped network on unfamiliar frames, and the kept results as the paper's Table II."""

import numpy as np
import pytest

from fakes.studio.training_frames import hard_frames
from rig.benchmark import segmentation
from rig.frames.masks import SegmentChoice
from rig.training.examples import examples_of


@pytest.mark.heavy
def test_shipped_network_finds_the_contacts_of_hard_lifts() -> None:
    score = segmentation.score_examples(
        "ours",
        SegmentChoice("ours"),
        segmentation.HARD,
        examples_of(hard_frames(segmentation.HELD_OUT, 11), 60, segmentation.FRAME_SIZE),
    )
    assert score.frames == 60
    # 0.9004 here. Products of eight-bit numbers are rounded by processor, so allow what eight bits may cost.
    assert score.dice.mean >= segmentation.LEAST_UNLIKE_DICE - segmentation.MOST_LOSS


@pytest.mark.heavy
def test_hard_frames_depend_on_the_seed_only_and_a_lift_shows_one_unit_and_object() -> None:
    made = [examples_of(hard_frames(segmentation.HELD_OUT, seed), 12, (60, 80)) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(made[0].frames, made[1].frames)
    assert (made[0].frames != made[2].frames).any()
    for lift, _ in zip(hard_frames(segmentation.HELD_OUT, 5), range(3), strict=False):
        assert len({shown.object_id for shown in lift}) == 1
        assert all((shown.background == lift[0].background).all() for shown in lift)
        assert all(shown.touching is not None and shown.touching.any() for shown in lift)


def test_table_two_has_a_row_per_network_and_fold_with_training_settings() -> None:
    table = segmentation.table_two()
    rows = {(row[0], row[1]): row for row in table.rows}
    assert len(rows) == 12
    assert "SIMULATED" in table.title
    for kept in segmentation.trained_models():
        row = rows[kept["title"], kept["fold"]]
        width, height = kept["size_px"]
        assert row[2].startswith(f"{kept['dice']:.3f}")
        assert f"{width}x{height} px, {kept['images']['train']} x {kept['epochs']}" in row[6]
