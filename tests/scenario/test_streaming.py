"""Frames of a recorded lift given one by one to `rig.estimator`: the angles of the lift, bit for bit."""

from pathlib import Path

import pytest

import rig
from drivers.clock import NS_PER_S
from protocols.observer import Phase
from rig.frames.of_session import recording_frames
from rig.sessions.reading import phase_times, recorded_angles
from rig.sessions.recorder import slip_topic
from support.marks import long

Values = tuple[float | None, float | None, str, float | None]


@pytest.mark.parametrize("place", [0, *long(1)])
def test_streamed_frames_give_the_angles_of_the_lift(one_lift: Path, place: int) -> None:
    recording = one_lift / "lifts" / "001.mcap"
    tip, phases = recording_frames(recording)[place], phase_times(recording)
    lift_ns, lower_ns = phases[Phase.LIFT], phases[Phase.LOWER]
    estimator = rig.estimator("slip", background=tip.background, pixel_aspect=tip.aspect, sign=tip.sign)
    streamed: dict[int, Values] = {}
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
            streamed[frame.time.time_ns] = (
                sample.angle_deg, sample.sigma_deg, sample.state, sample.contact_area_px
            )  # fmt: skip
    topic = slip_topic(tip.serial)
    stored: dict[int, Values] = {
        angle.time_ns: (angle.angle_deg, angle.sigma_deg, angle.state, angle.contact_area_px)
        for angle in recorded_angles(recording, topic)[topic]
        if angle.time_ns >= lift_ns
    }
    assert streamed == stored
    angles = [angle for angle, *_ in streamed.values() if angle is not None]
    assert len(angles) > 30
    assert max(map(abs, angles)) > 5.0
