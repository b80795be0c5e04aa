"""The rule for touch."""

from rig.tactile.contact.gate import TouchDebounce


def test_touch_needs_three_frames_without_a_gap() -> None:
    touch = TouchDebounce()
    seen = []
    for contact in (True, False, True, True, True, False):
        touch.update(contact)
        seen.append(touch.sure)
    assert seen == [False, False, False, True, True, False]
