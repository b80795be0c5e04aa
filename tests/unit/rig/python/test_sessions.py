"""A stored trial through `import rig`: the same figures as its rows and tables have."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import rig
from drivers.errors import InputError, SessionError
from rig.sessions.rows import read_finished_lifts

STORED = Path(__file__).resolve().parents[3] / "data"
TRIAL = STORED / "stored_trial"


@pytest.fixture(scope="module")
def session() -> rig.Session:
    return rig.open_session(TRIAL)


def test_session_has_its_metadata(session: rig.Session) -> None:
    assert (session.simulated, session.complete, len(session), session.problems) == (True, True, 1, ())
    assert (session.bench, session.estimator) == ("fake", "pca")
    assert session.started.startswith("20")
    assert "SIMULATED" in repr(session)
    (lift,) = session
    assert (lift.number, lift.object, lift.name, lift.lift) == (1, "t2", "toothbrush", 1)
    assert "t2/1 toothbrush" in repr(lift)


def test_angles_and_truth_give_the_stored_error(session: rig.Session) -> None:
    (row,), (lift,) = read_finished_lifts(TRIAL), session
    assert row.re is not None
    phases = lift.phases_s
    inside = (lift.estimate.time_s >= phases["B"]) & (lift.estimate.time_s < phases["lower"])
    off = np.abs(lift.error_deg[inside])
    assert np.nanmean(off) == pytest.approx(row.re.mean_deg, abs=1e-6)
    assert lift.mean_error_deg == row.re.mean_deg
    assert lift.answered == row.answered
    within = rig.Angles(*(of[inside] for of in (lift.estimate.time_s, lift.estimate.angle_deg)))
    score = rig.score(within, lift.truth)
    assert (score.mean_deg, score.frames) == pytest.approx((row.re.mean_deg, row.re.frames), abs=1e-6)
    assert score.max_deg == pytest.approx(row.re.max_deg, abs=1e-6)
    assert np.isnan(score.within_two_sigma)  # pca has no sigma


def test_each_fingertip_has_angles_and_frames_with_masks(session: rig.Session) -> None:
    (lift,) = session
    for serial in lift.serials:
        assert len(lift.tip(serial)) > 10
        assert len(lift.tip(serial).states) == len(lift.tip(serial))
        frames = list(lift.frames(serial, masks="classical"))
        assert [f.time_s for f in frames] == sorted(f.time_s for f in frames)
        assert frames[0].image.shape == lift.background(serial).shape
        shares = [float((f.mask > 0).mean()) for f in frames if f.mask is not None]
        assert len(shares) == len(frames)
        assert shares[0] == 0.0
        assert max(shares) > 0.01
    assert next(iter(lift.frames(lift.serials[0]))).mask is None
    assert next(iter(lift.frames("camera"))).image.shape == (180, 240, 3)


def test_arm_wrench_gripper_and_markers_are_arrays(session: rig.Session) -> None:
    (lift,) = session
    arm, wrench, gripper, markers = lift.arm, lift.wrench, lift.gripper, lift.markers
    states = len(arm.time_s)
    assert arm.base_T_tcp.shape == (states, 4, 4)
    assert arm.joints_rad.shape == (states, 6)
    assert wrench.force_n.shape == wrench.torque_nm.shape == (states, 3)
    weight_n, twist_nm = (np.abs(of).max() for of in (wrench.force_n, wrench.torque_nm))
    assert weight_n > 1.0 > twist_nm > 0.0
    assert (np.diff(arm.time_s) >= 0).all()
    rise = arm.base_T_tcp[arm.time_s > 0, 2, 3].max() - arm.base_T_tcp[0, 2, 3]
    assert rise > 0.01
    assert gripper.opening_m.shape == gripper.moving.shape == gripper.time_s.shape
    assert len(markers.time_s) == len(list(lift.frames("camera")))
    assert markers.corners_px.shape == (len(markers.time_s), 2, 4, 2)
    seen = np.isfinite(markers.corners_px).all(axis=(1, 2, 3))
    assert seen.mean() > 0.5
    assert markers.corners_px[seen].min() > 0.0
    assert lift.arm is arm, "a recording is read once"


def test_tables_need_pandas(session: rig.Session, monkeypatch: pytest.MonkeyPatch) -> None:
    (lift,) = session
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=dict))
    columns = lift.to_pandas()
    assert list(columns) == ["time_s", "estimate_deg", "sigma_deg", "truth_deg", "state"]
    assert {len(column) for column in columns.values()} == {len(lift.estimate)}
    assert session.to_pandas()["object"] == ["t2"]
    assert list(lift.truth.to_pandas()) == ["time_s", "angle_deg", "sigma_deg", "state"]
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(InputError, match="pip install pandas"):
        lift.to_pandas()


def test_pandas_data_frame_is_returned(session: rig.Session) -> None:
    pytest.importorskip("pandas")
    table = session.lifts[0].to_pandas()
    assert table.shape == (len(session.lifts[0].estimate), 5)


def test_missing_sessions_and_fingertips_are_rejected() -> None:
    with pytest.raises(SessionError, match="there is no such session folder"):
        rig.open_session("nowhere")
    with pytest.raises(SessionError, match="opens trials"):
        rig.open_session(STORED / "stored_record")
    (lift,) = rig.open_session(str(TRIAL))
    for ask in (lift.tip, lift.background, lambda serial: next(iter(lift.frames(serial)))):
        with pytest.raises(InputError, match=r"unknown fingertip of .* 'left': choose one of"):
            ask("left")


@pytest.mark.heavy
def test_estimator_of_a_lift_gives_its_angles_and_needs_the_pixel_aspect(one_lift: Path) -> None:
    (lift,) = rig.open_session(one_lift).lifts
    serial = lift.serials[0]
    tip, frames = lift.tip(serial), list(lift.frames(serial))
    assert lift.pixel_aspect(serial) == 0.978
    assert (lift.sign(lift.serials[0]), lift.sign(lift.serials[1])) == (1, -1)

    def off_deg(estimator: rig.StreamingEstimator) -> float:
        # times since the start of the lift: most contacts begin at negative times
        samples = [estimator.update(frame.image, frame.time_s) for frame in frames]
        found = {round(frame.time_s, 6): s.angle_deg for frame, s in zip(frames, samples, strict=True)}
        angles = np.array([found[round(t, 6)] for t in tip.time_s.tolist()], float)
        assert np.array_equal(np.isnan(angles), np.isnan(tip.angle_deg))
        away = angles - tip.angle_deg
        return float(np.nanmax(np.abs(away - np.nanmedian(away))))

    assert off_deg(lift.estimator(serial)) < 1e-6
    known = {"background": lift.background(serial), "sign": lift.sign(serial)}
    assert off_deg(rig.estimator(pixel_aspect=lift.pixel_aspect(serial), **known)) < 1e-6
    assert off_deg(rig.estimator(**known)) > 0.05
    with pytest.raises(InputError, match="unknown fingertip"):
        lift.estimator("none")
