"""`rig explain`: the zero's slopes, turned by the estimated angle, are those of the later frame."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from drivers.errors import InputError
from rig.frames.stages import BAND_PX, GAP_PX, PANEL_HEIGHT_PX, explained_lift, stages_picture
from support.command_line import refusal, succeed

pytestmark = pytest.mark.heavy

STORED = Path(__file__).resolve().parents[3] / "data" / "stored_trial"


def unexplained(picture: np.ndarray) -> float:
    """Mean brightness of the last panel, where the rest of the slopes is drawn."""
    width = (picture.shape[1] - 2 * GAP_PX) // 3
    return float(picture[-PANEL_HEIGHT_PX - BAND_PX : -BAND_PX, -width:].mean())


def test_wrong_rotation_leaves_a_larger_residual() -> None:
    turn = replace(explained_lift(STORED, 1, None), aspect=None)
    assert abs(turn.angle_deg) > 3.0
    right, wrong = (stages_picture(replace(turn, angle_deg=sign * turn.angle_deg)) for sign in (1, -1))
    assert unexplained(right) < 0.8 * unexplained(wrong)


def test_texture_and_curvature_of_the_first_row_are_drawn_at_the_contact() -> None:
    picture = stages_picture(replace(explained_lift(STORED, 1, None), aspect=None)).astype(float)
    row, width = picture[BAND_PX : BAND_PX + PANEL_HEIGHT_PX], (picture.shape[1] - 2 * GAP_PX) // 3
    difference, texture, curvature = (row[:, k * (width + GAP_PX) :][:, :width] for k in range(3))
    change = np.abs(difference - 128.0).max(axis=2)
    contact = change > 0.3 * change.max()
    assert texture[contact].mean() > 3.0 * texture[~contact].mean()
    assert np.abs(curvature[contact] - 128.0).mean() > 3.0 * np.abs(curvature[~contact] - 128.0).mean()


def test_command_writes_a_picture_and_names_missing_input(tmp_path: Path) -> None:
    out = tmp_path / "stages.png"
    done = succeed("explain", str(STORED), "--out", str(out), "--json")
    assert cv2.imread(str(out)) is not None
    assert abs(json.loads(done.stdout)["angle_deg"]) > 3.0
    assert "image angle" in done.stderr
    with pytest.raises(InputError, match="no finished lift 9"):
        explained_lift(STORED, 9, None)
    assert "leave --background" in refusal("explain", str(STORED), "--background", "auto", "--out", str(out))
