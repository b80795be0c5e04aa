"""Recording grasp poses: stored and rejected frames."""

import cv2
import numpy as np
import pytest

from drivers.types import Frame
from rig.experiments.record import FRAMES_APART, PoseCapture
from rig.tactile.contact.finder import ContactFinder


@pytest.mark.heavy
def test_frames_without_contact_are_rejected_and_counted() -> None:
    rng = np.random.default_rng(0)
    empty = np.full((320, 240, 3), 100, np.uint8)
    pressed = empty.copy()
    cv2.ellipse(pressed, (120, 160), (30, 70), 20, 0, 360, (180, 60, 120), -1)
    observer = PoseCapture({"L": ContactFinder(empty), "R": ContactFinder(empty)})
    observer.want(4, grip_steps=2)
    for number in range(8 * FRAMES_APART):
        for serial in ("L", "R"):
            picture = pressed if number >= 2 * FRAMES_APART else empty
            noisy = (picture + rng.normal(0, 1.5, picture.shape)).clip(0, 255).astype(np.uint8)
            observer.frame(Frame(noisy, number, number, serial))
    assert observer.is_complete()
    assert observer.rejected == 4
    assert sorted(frame.serial for frame, _, _ in observer.taken) == ["L", "L", "R", "R"]
    assert all(area > 0 and grip == 2 for _, grip, area in observer.taken)
