"""Networks of the compared methods: resampling of the wrench, angles from files, and rejected files."""

import json
from collections.abc import Callable
from hashlib import sha256
from importlib.resources import as_file
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.clock import to_ns
from drivers.errors import InputError
from drivers.types import ArmMode, ArmState, Pose
from protocols.grasps import TRIAL_OBJECTS
from rig.tactile.contact.model_files import MODELS
from rig.tactile.estimators import ANGLENET, TOSKOV, choose_estimator
from rig.tactile.peers.learned import PERIOD_S, REST_S, WrenchSteps, load_image_network, load_wrench_network
from rig.tactile.sample import State

Image = NDArray[np.uint8]
Draw = Callable[..., Image]
BIAS = (1.0, -2.0, 3.0, 0.1, -0.2, 0.3)


def state(time_s: float, *wrench: float) -> ArmState:
    felt = tuple(b + w for b, w in zip(BIAS, wrench or (0.0,) * 6, strict=True))
    return ArmState(to_ns(time_s), Pose((0.4, 0.0, 0.2)), (0.0,) * 6, felt, ArmMode.RUNNING)  # type: ignore[arg-type]


@pytest.mark.parametrize("rate_hz", [30.0, 60.0, 500.0])
def test_steps_have_30_hz_at_any_rate_of_states(rate_hz: float) -> None:
    steps = WrenchSteps()
    made = [steps.add(state(i / rate_hz, 0.0, 0.0, -1.0 if i / rate_hz > 1.0 else 0.0, 0.0, 0.0, 0.0))
            for i in range(round(2.0 * rate_hz))]  # fmt: skip
    complete = [step for step in made if step is not None]
    assert len(complete) == pytest.approx((2.0 - REST_S) / PERIOD_S, abs=2)
    assert complete[0] == pytest.approx(np.zeros(6), abs=1e-6), "the wrench at rest is subtracted"
    assert complete[-1] == pytest.approx([0.0, 0.0, -1.0, 0.0, 0.0, 0.0], abs=1e-5)


def test_state_that_is_not_newer_is_ignored() -> None:
    once, twice = WrenchSteps(), WrenchSteps()
    for i in range(40):
        first = once.add(state(i * PERIOD_S, 0.1 * i, 0.0, 0.0, 0.0, 0.0, 0.0))
        second = twice.add(state(i * PERIOD_S, 0.1 * i, 0.0, 0.0, 0.0, 0.0, 0.0))
        assert twice.add(state(i * PERIOD_S, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0)) is None
        assert (first is None) == (second is None)
        assert first is None or (first == second).all()


def test_toskov_needs_the_wrench_and_reports_the_fingertip_angle(press: Draw, blank: Image) -> None:
    choice = choose_estimator(TOSKOV)
    left, right = choice.make(blank, None, 1), choice.make(blank, None, -1)
    assert left.update(press(10), 0).state is State.UNOBSERVABLE, "the wrist was not felt yet"
    for i in range(1, 60):
        for tip in (left, right):
            tip.arm(state(i * PERIOD_S, -0.1, 0.0, -0.4 if i > 30 else 0.0, 0.0, -0.01, 0.0))
    one, other = (tip.update(press(10), to_ns(2.1)) for tip in (left, right))
    assert one.state is other.state is State.TRACKING
    assert one.angle_deg == pytest.approx(-(other.angle_deg or 0.0))
    assert left.update(press(None), to_ns(2.2)).state is State.NO_CONTACT


def test_angle_net_reports_an_angle_for_every_contact(press: Draw, blank: Image) -> None:
    estimator = choose_estimator(ANGLENET).make(blank)
    touched, bare = estimator.update(press(10), 0), estimator.update(press(None), 1)
    assert touched.state is State.TRACKING
    assert abs(touched.angle_deg) < 90.0
    assert set(touched.stage_s) == {"contact", "network"}
    assert bare.state is State.NO_CONTACT


@pytest.mark.parametrize(("name", "precision"), [(ANGLENET, "fp16"), (TOSKOV, "fp32")])
def test_cards_match_the_files_beside_them(name: str, precision: str) -> None:
    card = json.loads((MODELS / f"{name}.json").read_text(encoding="utf-8"))
    assert card["files"][precision]["sha256"] == sha256((MODELS / f"{name}.onnx").read_bytes()).hexdigest()
    assert card["simulated"]
    assert not card["trained_on_test_lifts"]
    assert not set(card["objects"]["train"]) & set(TRIAL_OBJECTS)


def test_files_of_other_networks_are_refused(tmp_path: Path) -> None:
    with (
        as_file(MODELS / "toskov.onnx") as wrist,
        as_file(MODELS / "anglenet.onnx") as angle,
        as_file(MODELS / "ours.onnx") as mask,
    ):
        for file in (wrist, mask):
            with pytest.raises(InputError, match=r"train_angle\.py anglenet"):
                load_image_network(file)
        for file in (angle, mask):
            with pytest.raises(InputError, match=r"train_angle\.py toskov"):
                load_wrench_network(file)
        (tmp_path / "cut.onnx").write_bytes(angle.read_bytes()[:1000])
    for load in (load_image_network, load_wrench_network):
        with pytest.raises(InputError, match="not a complete ONNX"):
            load(tmp_path / "cut.onnx")
        with pytest.raises(InputError, match="file not found"):
            load(tmp_path / "missing.onnx")
