"""The alignment of a frame to keyframes, on a drawn contact with known poses."""

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from rig.tactile.slip.alignment import GRID_PX, GRID_RAD, Aligner, Fit, Pose, Reading
from rig.tactile.slip.gradient import LearntGradientMap, learn_map
from rig.tactile.slip.height import contact_box
from rig.tactile.slip.keyframe import Keyframe, make_keyframe
from rig.tactile.slip.loops import (
    COUNTED,
    CURVED,
    FACTS,
    FIRST,
    MIDDLE_X,
    MIDDLE_Y,
    MOST_POINTS,
    ROWS,
    X,
    Y,
    self_loss,
)  # fmt: skip
from rig.tactile.slip.parameters import ALIGNMENT
from rig.tactile.slip.search import FURTHER_SHARES
from rig.tactile.slip.slopes import slope_planes
from support.slip_frames import MIDDLE_PX, drawn, region_of, source_of, texture_of, work_of

START_DEG = 20.0
SHARES = ALIGNMENT.slopes_share, *FURTHER_SHARES
turns = st.floats(-9.0, 9.0)
"""Rotations from which one start is enough: 200 degrees a second at 30 frames a second, and a third more."""
shifts = st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)).map(lambda v: complex(*v))


def key_at(angle_deg: float, learnt: LearntGradientMap | None = None) -> tuple[Keyframe, LearntGradientMap]:
    source = source_of(drawn(angle_deg, seed=99))
    learnt = learnt or learn_map(source.difference, source.mask)
    assert learnt is not None
    key = make_keyframe(source, learnt)
    assert key is not None
    return key, learnt


KEY, MAP = key_at(START_DEG)
AT_START = Pose(math.radians(START_DEG), KEY.center_px)


def moved(turn_deg: float, shift_px: complex) -> Pose:
    """Return the true pose of the keyframe's center after a turn about the middle and a shift."""
    lever = KEY.center_px - MIDDLE_PX
    point = MIDDLE_PX + shift_px + lever * cmath.exp(-1j * math.radians(turn_deg))
    return Pose(math.radians(START_DEG + turn_deg), point)


def aligner_on(turn_deg: float, shift_px: complex, reading: Reading, keys: list[Keyframe]) -> Aligner:
    """Return an aligner that views a frame in which the contact has moved."""
    fine, aligner = drawn(START_DEG + turn_deg, shift_px, seed=1), Aligner()
    mask = region_of(fine).mask
    box = contact_box(mask)
    aligner.take(keys)
    slopes = slope_planes(work_of(fine), MAP, mask, box, ALIGNMENT.broad_share)
    aligner.view(slopes, box[:2], reading)
    aligner.view_texture(texture_of(fine))
    return aligner


def reading_of(slopes_share: float, *poses: Pose) -> Reading:
    reading = Reading(slopes_share, AT_START)
    reading.keys += poses or (AT_START,)
    return reading


def assert_found(fit: Fit, turn_deg: float, shift_px: complex, most_deg: float = 0.5) -> None:
    true = moved(turn_deg, shift_px)
    assert math.degrees(fit.angle_rad - true.angle_rad) == pytest.approx(0.0, abs=most_deg)
    assert abs(fit.pose.point_px - true.point_px) < 0.6 * most_deg


@given(turn=turns, shift=shifts)
@example(turn=9.0, shift=1.5 + 1.5j)  # wrong derivatives show at the largest rotations
@example(turn=-9.0, shift=1.5 + 1.5j)
def test_known_rotation_and_shift_are_found_in_all_readings(turn: float, shift: complex) -> None:
    aligners = [aligner_on(turn, shift, reading_of(share), [KEY]) for share in SHARES]
    for aligner in aligners:
        assert_found(aligner.both([AT_START]), turn, shift)
    alone = aligners[0].alone(AT_START)
    if alone.best >= ALIGNMENT.plain_fit:
        assert_found(alone, turn, shift)


@given(turn=st.floats(-40.0, 40.0), shift=shifts)
def test_search_by_curvature_ends_within_a_step_of_the_grid(turn: float, shift: complex) -> None:
    aligner = aligner_on(turn, shift, reading_of(ALIGNMENT.slopes_share), [KEY])
    found, true = aligner.search_grid(AT_START, 5, 2), moved(turn, shift)
    assert abs(found.angle_rad - true.angle_rad) < GRID_RAD
    assert abs(found.point_px - true.point_px) < 2.0 * GRID_PX
    assert_found(aligner.both([found]), turn, shift)


@given(turn=turns)
def test_loss_is_small_at_the_true_pose_and_grows_by_one_per_ten_degrees(turn: float) -> None:
    aligner = aligner_on(turn, 0j, reading_of(ALIGNMENT.slopes_share), [KEY])
    true, wrong = aligner.at(moved(turn, 0j)), aligner.at(moved(turn + 10.0, 0j))
    assert true.loss < 0.3
    assert 0.7 < wrong.loss - true.loss < 1.3
    assert wrong.rank < true.rank


def test_fit_of_several_starts_is_the_one_with_the_highest_rank() -> None:
    aligner = aligner_on(6.0, 0j, reading_of(ALIGNMENT.slopes_share), [KEY])
    far = moved(150.0, 3 + 3j)
    ranks = [aligner.both([start]).rank for start in (far, AT_START)]
    assert ranks[0] < ranks[1]
    assert aligner.both([far, AT_START]).rank == pytest.approx(max(ranks))
    assert_found(aligner.both([far, AT_START]), 6.0, 0j)


@given(turn=st.floats(-10.0, 30.0))
def test_two_keyframes_give_the_same_pose_as_one(turn: float) -> None:
    other, _ = key_at(START_DEG + 20.0, MAP)
    lever = other.center_px - MIDDLE_PX
    point = MIDDLE_PX + (KEY.center_px - MIDDLE_PX) * cmath.exp(-1j * math.radians(20.0))
    assert abs(lever) < 3.0
    reading = reading_of(ALIGNMENT.slopes_share, AT_START, Pose(math.radians(START_DEG + 20.0), point))
    aligner = aligner_on(turn, 0j, reading, [KEY, other])
    assert len(aligner.used) == 2
    assert_found(aligner.both([moved(turn + 3.0, 0j)]), turn, 0j)


def test_poor_keyframes_are_not_aligned_to_and_the_richest_comes_first() -> None:
    source = source_of(drawn(START_DEG))
    faint = replace(source.texture, planes=0.3 * source.texture.planes)
    poor = make_keyframe(replace(source, texture=faint), MAP)
    assert poor.richness < 0.5 * KEY.richness
    reading = reading_of(ALIGNMENT.slopes_share, AT_START, AT_START, AT_START)
    assert aligner_on(0.0, 0j, reading, [poor, KEY, KEY]).used.tolist() == [1, 2]


def test_flat_frame_gives_no_map_and_no_keyframe() -> None:
    source = source_of(drawn(START_DEG))
    flat = replace(source, difference=np.zeros_like(source.difference))
    assert learn_map(flat.difference, flat.mask) is None
    assert make_keyframe(flat, MAP) is None
    untextured = replace(source.texture, planes=np.zeros_like(source.texture.planes))
    assert make_keyframe(replace(source, texture=untextured), MAP) is None


@given(seed=st.integers(0, 1000))
def test_alignment_to_noise_is_finite_and_scores_below_the_limit(seed: int) -> None:
    aligner = aligner_on(0.0, 0j, reading_of(ALIGNMENT.slopes_share), [KEY])
    noise = np.random.default_rng(seed).normal(0.0, 0.1, (4, 80, 60)).astype(np.float32)
    aligner.view(noise, (0, 0), reading_of(ALIGNMENT.slopes_share))
    rough = texture_of(np.random.default_rng(seed).normal(0.0, 0.1, (160, 120, 3)).astype(np.float32))
    aligner.view_texture(rough)
    fit = aligner.both([AT_START])
    assert np.isfinite([*fit.pose, fit.score, fit.loss, fit.rank]).all()
    assert fit.score < ALIGNMENT.least_score
    assert fit.best < ALIGNMENT.plain_fit


def edge_loss(radius_px: float) -> float:
    """Return `self_loss` of the curvature of an edge of 32 px with a radius, for a rotation by 10 degrees."""
    rows, columns = np.mgrid[:80, :80]
    x, y = columns - 40.0, rows - 40.0 + radius_px  # from the centre of the arc, whose middle is at (40, 40)
    away, along = np.hypot(x, y) - radius_px, radius_px * np.arctan2(x, y)
    curvature = np.exp(-((away / 2.0) ** 2)) * (np.abs(along) < 16.0)
    planes = np.stack([np.zeros_like(curvature)] * 3 + [curvature]).astype(np.float32)
    at = np.nonzero(curvature > 0.05)
    count = len(at[0])
    points, facts = np.zeros((ROWS, MOST_POINTS), np.float32), np.zeros(FACTS)
    points[X, :count], points[Y, :count], points[FIRST, :count] = at[1] - 40.0, at[0] - 40.0, curvature[at]
    facts[MIDDLE_X], facts[MIDDLE_Y], facts[COUNTED + CURVED] = 40.0, 40.0, count
    return float(self_loss(points, facts, planes, np.array([1.0, 0.0, 0.0]), math.radians(10.0)))


def test_arc_shows_a_rotation_less_than_a_straight_edge() -> None:
    """An arc that turns about its own centre looks the same; so a shift hides a rotation about its middle."""
    assert edge_loss(20.0) < 0.5 * edge_loss(2000.0)
