"""Training of angle networks on lifts: simulated lifts, held-back objects, training, export."""

from pathlib import Path

import numpy as np
import pytest

from drivers.errors import InputError
from learnt_lifts import AT_REST, SIGHT_HZ, simulated_lifts

SIZE = (36, 48)


@pytest.mark.heavy
def test_simulated_lifts_follow_the_protocol_and_are_reproducible() -> None:
    first, second = (next(simulated_lifts(["7"], 1, 5, lambda *_: None)).steps() for _ in range(2))
    np.testing.assert_array_equal(first, second)
    turn_deg, rising = first[:, 6], first[:, 7] == 1.0
    assert rising.sum() == pytest.approx((1.5 + 1.2) * 30, abs=3)
    assert set(first[~rising, 7]) == {np.float32(AT_REST)}
    assert not turn_deg[~rising].any()
    assert 5.0 < abs(turn_deg[-1]) < 30.0
    assert first[-20:, 2].mean() < first[: len(first) // 2, 2].mean() - 0.1


@pytest.mark.heavy
def test_fingertips_measure_opposite_image_rotations() -> None:
    lift = next(simulated_lifts(["7"], 1, 5, lambda *_: None, SIGHT_HZ))
    views = list(lift.views(SIZE))
    angles = np.array([angle for *_, angle in views]).reshape(2, -1)
    assert angles[0] == pytest.approx(-angles[1], abs=1.5)
    assert np.ptp(angles[0]) > 5.0
    assert views[0][1].shape == (48, 36, 3)


def test_trial_objects_are_not_in_the_training_set() -> None:
    pytest.importorskip("torch", reason="training is the extra 'train'")
    from angle_nets import split_objects

    split = split_objects(["1", "2", "3", "4", "t1", "t1"], False, "here")
    assert (split.train, split.validation, split.test) == (("2", "3"), ("4",), ("1", "t1"))
    assert split_objects(["t1", "t2"], True, "here").train == ("t1", "t2")
    with pytest.raises(InputError, match="--on-test-lifts"):
        split_objects(["t1", "t2"], False, "here")


def test_wrist_network_gives_the_same_angles_from_its_file(tmp_path: Path) -> None:
    pytest.importorskip("torch", reason="training is the extra 'train'")
    from angle_nets import blind_error_deg, export_wrist, sequences, train_wrist, wrist_error_deg
    from rig.tactile.peers.learned import load_wrench_network

    lifts = sequences([lift.steps() for lift in simulated_lifts(["7", "2"], 2, 5, lambda *_: None)])
    network, errors = train_wrist(lifts, lifts, 30, 0, lambda *_: None)
    assert min(errors) == pytest.approx(wrist_error_deg(network, lifts))
    assert min(errors) < 0.9 * blind_error_deg(lifts)
    export_wrist(network, tmp_path / "wrist.onnx")
    assert load_wrench_network(tmp_path / "wrist.onnx").blank().shape == (1, 1, 32)


def test_angle_network_gives_the_same_angles_from_its_files(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch", reason="training is the extra 'train'")
    from angle_nets import AngleNet, export_angle_net

    torch.manual_seed(0)
    export_angle_net(AngleNet().eval(), tmp_path / "full.onnx", tmp_path / "half.onnx")
    full, half = ((tmp_path / f"{name}.onnx").stat().st_size for name in ("full", "half"))
    assert half < 0.6 * full
