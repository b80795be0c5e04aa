"""`rig explain`: the zero's slopes, turned by the estimated angle, are those of the later frame."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.errors import InputError
from rig.frames.of_session import session_frames
from rig.frames.stages import GAP_PX, PANEL_HEIGHT_PX, explained_lift, stages_picture
from support.command_line import rig

STORED = Path(__file__).resolve().parents[3] / "data" / "stored_trial"


def unexplained(picture: np.ndarray) -> float:
    """Mean brightness of the last panel, where the rest of the slopes is drawn."""
    width = (picture.shape[1] - 2 * GAP_PX) // 3
    band = picture.shape[0] - 2 * PANEL_HEIGHT_PX
    return float(picture[-PANEL_HEIGHT_PX - band // 3 : -band // 3, -width:].mean())


def test_a_wrong_turn_explains_less() -> None:
    picture, turn = explained_lift(STORED, 1, None)
    assert abs(turn.angle_deg) > 3.0
    background = session_frames(STORED)[0][0].background
    right, wrong = (
        stages_picture(replace(turn, angle_deg=sign * turn.angle_deg), background, None, "a turn")
        for sign in (1, -1)
    )
    assert unexplained(right) < 0.8 * unexplained(wrong)
    assert picture.shape == right.shape


def test_the_command_writes_a_picture_and_names_what_is_not_there(tmp_path: Path) -> None:
    out = tmp_path / "stages.png"
    done = rig("explain", str(STORED), "--out", str(out), "--json")
    assert done.returncode == 0, done.stderr
    assert cv2.imread(str(out)) is not None
    assert "image angle" in done.stderr
    with pytest.raises(InputError, match="no finished lift 9"):
        explained_lift(STORED, 9, None)
    refused = rig("explain", str(STORED), "--background", "auto", "--out", str(out))
    assert refused.returncode == 2
    assert "leave --background" in refused.stderr
