"""The state of the hand is stored in files and read by the next program."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from scipy.spatial.transform import Rotation

from drivers.bench import Hand
from drivers.errors import DeviceTimeoutError, RecordingError
from drivers.types import Frame, HandState, Holding, Pose
from rig.bench.source import HandMemory

HELD = HandState(
    Holding.HELD, "wrench", Pose.from_rotation((0.5, 0.0, 0.06), Rotation.from_euler("x", 180)), 0.012
)


@pytest.fixture(autouse=True)
def state_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    return tmp_path


def tips(*images: Any) -> Any:
    """A bench with fingertips that show these images."""

    def sensor(number: int, image: Any) -> Any:
        frame = None if image is None else Frame(image, 0, 0, f"D{number}")

        def next_frame(_: float) -> Frame:
            if frame is None:
                raise DeviceTimeoutError(f"D{number}: no frame")
            return frame

        return SimpleNamespace(serial=f"D{number}", next_frame=next_frame, newest_frame=next_frame)

    return SimpleNamespace(fingertips=[SimpleNamespace(sensor=sensor(n, i)) for n, i in enumerate(images, 1)])


def test_next_program_reads_the_stored_state_of_the_hand() -> None:
    memory = HandMemory("192.0.2.10")
    assert memory.recall().holding is Holding.UNKNOWN
    hand = Hand(memory.recall(), memory.keep)
    hand.note(HELD)
    assert HandMemory("192.0.2.10").recall() == HELD
    hand.note(HandState(Holding.FREE, finger_opening_m=0.0173))
    assert HandMemory("192.0.2.10").recall() == HandState(Holding.FREE, finger_opening_m=0.0173)
    for one, other in (("arm-1:30004", "arm-1_30004"), ("arm/1", "arm_1"), ("a b", "a_b")):
        HandMemory(one).recall()
        HandMemory(one).keep(HELD)
        assert HandMemory(other).recall().holding is Holding.UNKNOWN
        assert HandMemory(one).recall() == HELD


FREE = '{"holding": "free", "what": "", "base_T_grasp": null, "width_m": 0.0, "%s": %s}'


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", '{"holding": "free"}', '{"holding": "so"}', "\xff",
     *(FREE % ("finger_opening_m", value) for value in ("true", '"9"'))],
)  # fmt: skip
def test_unreadable_hand_memory_is_unknown(state_home: Path, text: str) -> None:
    HandMemory("arm").recall()
    HandMemory("arm").keep(HELD)
    (file,) = (state_home / "visuotactile-slip-rig" / "hands").iterdir()
    file.write_text(text, "latin-1")
    recalled = HandMemory("arm").recall()
    assert recalled.holding is Holding.UNKNOWN
    assert "damaged" in recalled.what


def test_unwritable_hand_memory_refuses_a_new_run_and_not_a_running_one(
    state_home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (state_home / "file").write_text("")
    monkeypatch.setenv("XDG_STATE_HOME", str(state_home / "file"))
    memory = HandMemory("arm")
    with pytest.raises(RecordingError, match="XDG_STATE_HOME"):
        memory.recall()
    memory.keep(HELD)


def test_fingertips_are_compared_with_their_stored_no_contact_frames(press: Any) -> None:
    untouched, touched = press(None, seed=1), press(20.0, seed=2)
    memory = HandMemory("arm")
    memory.recall()
    assert memory.tips_in_contact(tips(touched, touched)) == []  # nothing to compare with
    memory.keep_untouched(tips(untouched, press(None, seed=3)))
    assert memory.tips_in_contact(tips(press(None, seed=4), press(None, seed=5))) == []
    assert memory.tips_in_contact(tips(press(None, seed=4), touched)) == ["D2"]
    assert memory.tips_in_contact(tips(None, touched)) == ["D2"]
    memory.keep_untouched(tips(None, untouched))
    assert memory.tips_in_contact(tips(touched, untouched)) == ["D1"]
