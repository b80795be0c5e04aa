"""Frames of a recorded lift given one by one to `rig.estimator`: the angles of the lift, bit for bit."""

from pathlib import Path

import numpy as np
import pytest

import rig
from drivers.clock import NS_PER_S
from protocols.observer import Phase
from rig.frames.of_session import recording_frames
from rig.sessions.reading import phase_times, recorded_angles
from rig.tactile.angles import Angles
from support.marks import long


@pytest.mark.parametrize("place", [0, *long(1)])
def test_streamed_frames_give_the_angles_of_the_lift(one_lift: Path, place: int) -> None:
    recording = one_lift / "lifts" / "001.mcap"
    tip, phases = recording_frames(recording)[place], phase_times(recording)
    lift_ns, lower_ns = phases[Phase.LIFT], phases[Phase.LOWER]
    estimator = rig.estimator("slip", background=tip.background, pixel_aspect=tip.aspect, sign=tip.sign)
    streamed: list[rig.SlipSample] = []
    zero_is_set = False
    for frame in tip.frames:
        if frame.time.time_ns >= lower_ns:
            break
        if not zero_is_set and frame.time.time_ns >= lift_ns:
            estimator.set_reference(lift_ns / NS_PER_S)
            zero_is_set = True
        assert frame.image is not None
        sample = estimator.update(frame.image, frame.time.time_ns / NS_PER_S)
        if zero_is_set:
            streamed.append(sample)
    angles = Angles.of(streamed, tip.serial)
    stored = recorded_angles(recording, tip.serial)[tip.serial].between(lift_ns, lower_ns)
    assert angles.states == stored.states
    for column in ("time_ns", "angle_deg", "sigma_deg", "contact_area_px"):
        np.testing.assert_array_equal(getattr(angles, column), getattr(stored, column))
    assert len(angles.known) > 30
    assert np.abs(angles.known.angle_deg).max() > 5.0
