"""Training of angle networks on lifts: held-back objects, training, export."""

from pathlib import Path

import pytest

from drivers.errors import InputError
from rig.training.lifts import simulated_lifts

torch = pytest.importorskip("torch", reason="training is the extra 'train'")


def test_trial_objects_are_not_in_the_training_set() -> None:
    from rig.training.angles import split_objects

    split = split_objects(["1", "2", "3", "4", "t1", "t1"], False, "here")
    assert (split.train, split.validation, split.test) == (("2", "3"), ("4",), ("1", "t1"))
    assert split_objects(["t1", "t2"], True, "here").train == ("t1", "t2")
    with pytest.raises(InputError, match="--on-test-lifts"):
        split_objects(["t1", "t2"], False, "here")


def test_wrist_network_gives_the_same_angles_from_its_file(tmp_path: Path) -> None:
    from rig.tactile.peers.learned import load_wrench_network
    from rig.training.angles import blind_error_deg, export_wrist, sequences, train_wrist, wrist_error_deg

    lifts = sequences([lift.steps() for lift in simulated_lifts(["7", "2"], 2, 5, lambda *_: None)])
    network, errors = train_wrist(lifts, lifts, 30, 0, lambda *_: None)
    assert min(errors) == pytest.approx(wrist_error_deg(network, lifts))
    assert min(errors) < 0.9 * blind_error_deg(lifts)
    export_wrist(network, tmp_path / "wrist.onnx")
    assert load_wrench_network(tmp_path / "wrist.onnx").blank().shape == (1, 1, 32)


def test_angle_network_gives_the_same_angles_from_its_files(tmp_path: Path) -> None:
    from rig.training.angles import AngleNet, export_angle_net

    torch.manual_seed(0)
    export_angle_net(AngleNet().eval(), tmp_path / "full.onnx", tmp_path / "half.onnx")
    full, half = ((tmp_path / f"{name}.onnx").stat().st_size for name in ("full", "half"))
    assert half < 0.6 * full
