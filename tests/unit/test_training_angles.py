"""Learning angles from lifts: what is learnt from, how objects are held back, and what is exported."""

from pathlib import Path

import numpy as np
import pytest

from drivers.errors import InputError
from rig.training.simulated_lifts import simulated_views, simulated_wrists

SIZE = (36, 48)


def test_simulated_lifts_are_those_of_the_protocol_and_the_same_again() -> None:
    first, second = (simulated_wrists(["7"], 1, 5, lambda *_: None)[0] for _ in range(2))
    assert first.states == second.states
    assert (first.turn_deg == second.turn_deg).all()
    assert first.rising.sum() == pytest.approx((1.5 + 1.2) * 30, abs=3)
    assert not first.turn_deg[~first.rising].any()
    assert 5.0 < abs(first.turn_deg[-1]) < 30.0
    pulled = np.array([s.wrench[2] for s in first.states])
    assert pulled[-20:].mean() < pulled[: -len(pulled) // 2].mean() - 0.1


def test_both_fingertips_see_the_object_turn_from_opposite_sides() -> None:
    views = list(simulated_views(["7"], 1, 5, SIZE, lambda *_: None))
    angles = np.array([angle for *_, angle in views]).reshape(2, -1)
    assert angles[0] == pytest.approx(-angles[1], abs=1.5)
    assert np.ptp(angles[0]) > 5.0
    assert views[0][1].shape == (48, 36, 3)


torch = pytest.importorskip("torch", reason="training is the extra 'train'")
pytest.importorskip("segmentation_models_pytorch", reason="training is the extra 'train'")


def test_the_trials_objects_are_held_back() -> None:
    from rig.training.angles import split_objects

    split = split_objects(["1", "2", "3", "4", "t1", "t1"], False, "here")
    assert (split.train, split.validation, split.test) == (("2", "3"), ("4",), ("1", "t1"))
    assert split_objects(["t1", "t2"], True, "here").train == ("t1", "t2")
    with pytest.raises(InputError, match="--on-test-lifts"):
        split_objects(["t1", "t2"], False, "here")


def test_a_wrist_network_is_trained_and_answers_alike_from_its_file(tmp_path: Path) -> None:
    from rig.tactile.peer_networks import load_wrench_network
    from rig.training.peer_export import export_wrist
    from rig.training.wrist import blind_error_deg, error_deg, sequences, train_wrist

    lifts = sequences(simulated_wrists(["7", "2"], 2, 5, lambda *_: None))
    network, errors = train_wrist(lifts, lifts, 25, 0, lambda *_: None)
    assert min(errors) == pytest.approx(error_deg(network, lifts))
    assert min(errors) < 0.8 * blind_error_deg(lifts)
    export_wrist(network, tmp_path / "wrist.onnx")
    assert load_wrench_network(tmp_path / "wrist.onnx").blank().shape == (1, 1, 32)


def test_an_angle_network_answers_alike_from_its_files(tmp_path: Path) -> None:
    from rig.training.angle_net import AngleNet
    from rig.training.peer_export import export_angle_net

    torch.manual_seed(0)
    export_angle_net(AngleNet().eval(), tmp_path / "full.onnx", tmp_path / "half.onnx")
    full, half = ((tmp_path / f"{name}.onnx").stat().st_size for name in ("full", "half"))
    assert half < 0.6 * full
