"""The second renderer: its images match its ground truth."""

import cv2
import numpy as np
import pytest

from rig.benchmark import renderer


def pressed(kind: str, angle_deg: float) -> np.ndarray:
    """Return the change of the image by a face, (H, W)."""
    camera, noise = renderer.GelCamera(3), np.random.default_rng(0)
    empty = camera.picture(None, 0.0, (0.0, 0.0), 0.0, noise).astype(float)
    seen = camera.picture(
        renderer.draw_face(kind, renderer.KIND_NAMES.index(kind), 0),
        np.radians(angle_deg),
        (0.0, 0.0),
        0.6,
        noise,
    )
    return cv2.GaussianBlur(np.abs(seen - empty).sum(axis=2), (0, 0), 2.0)


def axis_deg(change: np.ndarray) -> float:
    """Return the long axis of the changed pixels, counter-clockwise as seen, modulo 180."""
    rows, columns = np.nonzero(change > 0.4 * change.max())
    (dx, dy) = np.linalg.eigh(np.cov(columns, rows))[1][:, 1]
    return float(np.degrees(np.arctan2(-dy, dx))) % 180.0


@pytest.mark.parametrize("angle_deg", [-50.0, -25.0, 25.0, 50.0])
def test_face_turns_counter_clockwise_as_seen(angle_deg: float) -> None:
    off = axis_deg(pressed("blade", angle_deg)) - axis_deg(pressed("blade", 0.0)) - angle_deg
    assert abs((off + 90.0) % 180.0 - 90.0) < 15.0  # the picture cuts a long face off


@pytest.mark.parametrize("kind", renderer.SOFT)
def test_soft_body_does_not_turn_with_its_relief(kind: str) -> None:
    one, other = (cv2.GaussianBlur(pressed(kind, angle), (0, 0), 12.0) for angle in (0.0, 60.0))
    assert np.corrcoef(one.ravel(), other.ravel())[0, 1] > 0.9


def test_codec_blocks_are_constant_until_the_refresh() -> None:
    camera, noise = renderer.GelCamera(4), np.random.default_rng(0)
    shots = [camera.draw_codec_errors(noise).copy() for _ in range(camera.refresh + 1)]
    assert all((shot == shots[0]).all() for shot in shots[:-1])
    assert (shots[-1] != shots[0]).any()


def test_lift_is_reproducible_and_starts_at_rest() -> None:
    one, again, other = (next(renderer.frames(seed, 0)).image for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert (one != other).any()
    course = renderer.draw_course(1)
    assert not course.turn_deg[course.time_ns < renderer.LIFT_NS].any()
    assert len({renderer.draw_course(seed).turn_deg[-1] for seed in range(20)}) > 15
