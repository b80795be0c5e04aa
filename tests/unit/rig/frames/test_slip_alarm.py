"""The slip alarm over a recording: armed by the lift, never by the grasp."""

from collections.abc import Sequence

from rig.frames.slip_alarm import SlipAlarm, slips
from rig.tactile.sample import SlipSample, State
from rig.tactile.settling import SettlingByArea

STEP_NS = 20_000_000


def samples(areas: Sequence[float], angles: Sequence[float | None]) -> list[SlipSample]:
    """Answers 20 ms apart; the rate is that of the angles."""
    found, last, rule = [], 0.0, SettlingByArea()
    for i, (area, angle) in enumerate(zip(areas, angles, strict=True)):
        state = State.TRACKING if area else State.NO_CONTACT
        rate = None if angle is None else (angle - last) / (STEP_NS * 1e-9)
        settled = rule.update(area, i * STEP_NS)
        found.append(SlipSample(i * STEP_NS, state, angle, None, 0.0, rate, None, area, settled=settled))
        last = last if angle is None else angle
    return found


GRASP = [0.0, 0.0, 100.0, 200.0, 400.0, 700.0]
"""Areas while the fingers close; the contact turns by 3 degrees meanwhile."""
TURNED = [None, None, 0.0, 1.0, 2.0, 3.0]
REST = 20
SLIP = [3.0 + 0.3 * i for i in range(1, 11)]


def a_lift() -> list[SlipSample]:
    return samples([*GRASP, *[700.0] * (REST + len(SLIP))], [*TURNED, *[3.0] * REST, *SLIP])


def first(slipped: Sequence[bool | None]) -> int | None:
    return next((i for i, now in enumerate(slipped) if now), None)


def test_rotation_while_the_contact_grows_is_no_slip() -> None:
    raised = first(slips(a_lift()))
    assert raised is not None
    assert len(GRASP) + REST < raised < len(GRASP) + REST + 4
    assert first(slips(a_lift()[: len(GRASP) + REST])) is None


def test_known_lift_time_arms_the_alarm() -> None:
    samples = a_lift()
    begin = len(GRASP) + REST + 5
    raised = first(slips(samples, begin * STEP_NS))
    assert raised is not None
    assert raised > begin
    assert first(slips(samples, len(samples) * STEP_NS)) is None
    assert first(slips(samples, 0)) == 3, "the grasp's own turn, if the lift is said to begin before it"


def test_unsettled_contact_does_not_arm_the_alarm() -> None:
    areas = [100.0 * 1.08**i for i in range(30)]
    assert first(slips(samples(areas, [0.5 * i for i in range(30)]))) is None


def test_new_grasp_disarms_the_alarm() -> None:
    gone = [0.0] * 30
    again = samples(
        [*GRASP, *[700.0] * (REST + len(SLIP)), *gone, *GRASP[2:], *[700.0] * REST],
        [*TURNED, *[3.0] * REST, *SLIP, *[None] * 30, *[9.0, 10.0, 11.0, 12.0], *[12.0] * REST],
    )
    slipped = slips(again)
    assert slipped[len(a_lift()) - 1]
    assert not any(slipped[len(a_lift()) + 30 :])


def test_alarm_ends_when_the_motion_has_ended_and_its_event_is_kept() -> None:
    at = len(a_lift())
    twice = samples(
        [*GRASP, *[700.0] * (REST + 2 * len(SLIP) + 12)],
        [*TURNED, *[3.0] * REST, *SLIP, *[SLIP[-1]] * 12, *[SLIP[-1] - 0.3 * i for i in range(1, 11)]],
    )
    alarm = SlipAlarm()
    on = [alarm.update(sample) for sample in twice]
    begun = on.index(True)
    assert on[begun : at + 4] == [True] * (at + 4 - begun), "until 100 ms after the last motion"
    assert on[at + 4 : at + 12] == [False] * 8
    assert on[-1], "the next slip counts from the angle at which the first one ended"
    again = at + 12 + on[at + 12 :].index(True)
    assert list(alarm.raised_ns) == [begun * STEP_NS, again * STEP_NS]


def test_rate_noise_is_no_slip_and_a_slow_slip_is_detected() -> None:
    noise = [3.0 + (0.0, 0.3, 0.0, -0.1)[i % 4] for i in range(REST)]
    outlier, slow = [3.45] * 5, [3.0 + 0.06 * i for i in range(40)]
    areas = [*GRASP, *[700.0] * (REST + 40)]
    assert first(slips(samples(areas, [*TURNED, *noise, *outlier, *[3.0] * 35]))) is None
    raised = first(slips(samples(areas, [*TURNED, *noise, *slow])))
    assert raised is not None
    assert slow[raised - len(GRASP) - REST] < 4.0


def test_a_short_gap_is_the_same_grasp() -> None:
    samples = a_lift()
    gap = len(GRASP) + 12
    for i in range(gap, gap + 5):
        samples[i] = SlipSample(samples[i].time_ns, State.NO_CONTACT)
    assert first(slips(samples)) == first(slips(a_lift()))


def test_estimator_without_rate_raises_no_alarm() -> None:
    samples = [SlipSample(i * STEP_NS, State.TRACKING, float(i), contact_area_px=100.0) for i in range(30)]
    assert slips(samples) == [None] * 30
