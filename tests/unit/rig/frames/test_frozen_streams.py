"""A frozen sensor in every stream: no angle, the state `frozen`, a message, and normal again afterwards."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

import rig
from drivers.clock import NS_PER_S
from drivers.images import decode_stored, encode_jpeg, encode_png
from drivers.tally import FROZEN_NS
from drivers.types import Frame, Image
from rig.contract_checks import gel, pressed_bar
from rig.experiments.lift_plan import stored_trial
from rig.experiments.replay import run_replay
from rig.live.desk import Desk, DeskSettings
from rig.live.desk_sensor import Reading
from rig.live.feed import Sender
from rig.python.fingertip import LiveFingertip
from rig.tactile.estimators import ESTIMATORS, TOSKOV, choose_estimator
from support.command_line import rig as command
from support.desk_frames import GivenFrames
from support.marks import heavy
from support.played_sensor import play
from support.recordings import written_again

pytestmark = pytest.mark.heavy

RATE_HZ = 60.0
UNTOUCHED, LIVE, FROZEN, AFTER = 20, 50, 60, 60
"""Frames of the gel, of a contact, of a frozen camera while the object turns, and of the turned contact."""
FROZEN_FROM = UNTOUCHED + LIVE
SOME_ESTIMATORS = ("slip", "pca", "ecc")
LATE = round(FROZEN_NS / NS_PER_S * RATE_HZ) + 1
TURN_DEG = 17.0
STORED = Path(__file__).parents[3] / "data" / "stored_trial"


def one_pixel(image: Image, number: int) -> Image:
    copy = image.copy()
    copy[number % 100, number % 50] ^= 255
    return copy


def clip() -> list[Image]:
    bars = [pressed_bar(20.0, 100 + i) for i in range(LIVE)]
    copies = [one_pixel(bars[-1], i) for i in range(FROZEN)]
    after = [pressed_bar(20.0 + TURN_DEG, 300 + i) for i in range(AFTER)]
    return [*(gel(320, 240, i) for i in range(UNTOUCHED)), *bars, *copies, *after]


def require_frozen(states: list[str], angles: list[float | None]) -> None:
    """Fail unless the frames of the frozen camera are marked after the limit, and no others."""
    assert set(states[FROZEN_FROM + LATE : FROZEN_FROM + FROZEN]) == {"frozen"}
    assert "frozen" not in states[:FROZEN_FROM]
    assert "frozen" not in states[FROZEN_FROM + FROZEN :]
    assert all(a is None for a, s in zip(angles, states, strict=True) if s == "frozen")


@pytest.mark.parametrize(
    "name", [*SOME_ESTIMATORS, *heavy(*(n for n in ESTIMATORS if n not in (TOSKOV, *SOME_ESTIMATORS)))]
)
def test_every_estimator_refuses_a_frozen_sensor(name: str) -> None:
    estimator = choose_estimator(name).make(gel(320, 240))
    samples = [estimator.update(image, round(i / RATE_HZ * NS_PER_S)) for i, image in enumerate(clip())]
    require_frozen([s.state.value for s in samples], [s.angle_deg for s in samples])


def test_angle_after_the_freeze_has_a_sigma_that_covers_the_unseen_turn() -> None:
    with pytest.warns(UserWarning, match=r"frames: the sensor repeats its picture: it has frozen"):
        found = rig.estimate(clip(), gel(320, 240))
    angles = [None if np.isnan(angle) else angle for angle in found.angle_deg.tolist()]
    require_frozen(list(found.states), angles)
    known = [(a, s) for a, s in zip(angles[-AFTER:], found.sigma_deg[-AFTER:], strict=True) if a is not None]
    assert known, "back to normal"
    assert all(abs(angle - TURN_DEG) < 3.0 * sigma for angle, sigma in known)


def test_streaming_estimator_warns_once_and_goes_on() -> None:
    stream, found = rig.estimator("ellipse", background=gel(320, 240)), []
    with pytest.warns(UserWarning, match="it has frozen") as warned:
        found += [stream.update(image, i / RATE_HZ) for i, image in enumerate(clip())]
    assert len(warned) == 1
    require_frozen([sample.state for sample in found], [sample.angle_deg for sample in found])
    assert found[-1].angle_deg is not None


def test_live_view_shows_the_state_and_a_notice() -> None:
    frames = [Frame(image, round(i / RATE_HZ * NS_PER_S), i, "D") for i, image in enumerate(clip())]
    found: list[Reading] = []
    notices: list[str] = []
    with Desk([GivenFrames(frames)], DeskSettings(choose_estimator("slip")), Sender()) as desk:
        while not desk.has_ended:
            found += desk.step()
            notices += [] if notices[-1:] == [desk.notice] else [desk.notice]
    values = [reading.values() for reading in found]
    require_frozen([str(v["state"]) for v in values], [v["angle_deg"] for v in values])  # type: ignore[misc]
    assert sum("it has frozen" in notice for notice in notices) == 1


def test_frames_of_a_folder_are_marked_and_counted(tmp_path: Path) -> None:
    (tmp_path / "frames").mkdir()
    for i, image in enumerate(clip()):
        (tmp_path / "frames" / f"{i:04d}.png").write_bytes(encode_png(image))
    done = command(
        "estimate", tmp_path / "frames", "--background", "first:20", "--out", tmp_path / "angles.csv"
    )
    rows = [line.split(",") for line in (tmp_path / "angles.csv").read_text().splitlines()[1:]]
    require_frozen([row[3] for row in rows], [float(row[1]) if row[1] else None for row in rows])
    assert "the sensor repeats its picture: it has frozen, and there is no angle" in done.stderr


def test_fingertip_of_a_program_has_the_state_and_logs_it(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    sensor = play(monkeypatch, clip()[: FROZEN_FROM + FROZEN])
    tip, states = LiveFingertip("fake", "B", "ellipse"), []
    tip.connect()
    while len(sensor.images) > 1:
        tip.next(5.0)
        states.append(tip.angle())
    tip.disconnect()
    assert (states[-1].state, states[-1].angle_deg) == ("frozen", None)
    assert any(sample.state == "tracking" for sample in states)
    assert "the sensor repeats its picture" in caplog.text


def frozen_from(first: int) -> Callable[[int, bytes], bytes]:
    """Return a change of a camera's messages: it freezes at its nth picture, encoded again each time."""
    kept = b""

    def change(number: int, data: bytes) -> bytes:
        nonlocal kept
        picture = CompressedImage.FromString(data)
        kept = picture.data if number <= first else kept
        if number > first:
            picture.data = encode_jpeg(one_pixel(decode_stored(kept), number), 95)
        return picture.SerializeToString()

    return change


def test_replay_of_a_frozen_fingertip_has_no_angle_and_a_warning(tmp_path: Path) -> None:
    session = shutil.copytree(STORED, tmp_path / "trial")
    [stored] = run_replay(stored_trial(session), jobs=1).rows
    assert "frozen" not in stored.states
    change = frozen_from(stored.frames["SIM-D0001"] - 20)
    written_again(session / stored.recording, changed=("/image/SIM-D0001", change))
    [again] = run_replay(stored_trial(session), jobs=1).rows
    assert again.states["frozen"] >= 3
    assert "repeat" in again.warnings[0]
