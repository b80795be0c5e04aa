"""Estimators that are not the rig's own: how they are named, made, and what becomes of their faults."""

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from drivers.errors import EstimatorError, InputError, OperatorStopError
from drivers.types import Image
from rig.tactile.estimators import choose_estimator, stored_choice
from rig.tactile.sample import EstimatorFaults, SlipSample, State, faults_of
from support.own_estimators import MODULE, own_estimators

GEL: Image = np.random.default_rng(0).integers(90, 110, (120, 90, 3), np.uint8)
STEP_NS = 16_666_667


@pytest.fixture
def imported(tmp_path: Path) -> Iterator[Path]:
    with own_estimators(tmp_path) as file:
        yield file


def answers(name: str, frames: int) -> list[SlipSample]:
    estimator = choose_estimator(f"{MODULE}:{name}").make(GEL)
    return [estimator.update(GEL, i * STEP_NS) for i in range(frames)]


def test_class_is_created_by_full_name_and_by_entry_point(imported: Path) -> None:
    for name in (f"{MODULE}:Mine", "lab-pca"):
        choice = choose_estimator(name)
        assert (choice.name, choice.window, choice.foreign) == (name, 1, True)
        assert choice.make(GEL).update(GEL, 0).state is State.NO_CONTACT
    assert imported.exists()


def test_module_in_the_start_folder_is_found_and_hides_no_built_in_estimator(imported: Path) -> None:
    sys.path.remove(str(imported.parent))
    assert not choose_estimator("slip").foreign
    assert not imported.exists()
    assert choose_estimator(f"{MODULE}:Mine").foreign


def test_estimator_named_only_by_a_session_is_not_imported(imported: Path) -> None:
    for name in (f"{MODULE}:Mine", "lab-pca", "never heard of"):
        choice = stored_choice(name, 2)
        with pytest.raises(EstimatorError, match=r"add --estimator .*, or another"):
            choice.require_named()
        with pytest.raises(EstimatorError, match="not part of the rig"):
            choice.make(GEL)
    assert not imported.exists()
    assert stored_choice("slip", None).make(GEL).update(GEL, 0).state is State.NO_CONTACT
    assert stored_choice(f"{MODULE}:Mine", 1) == choose_estimator(f"{MODULE}:Mine")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("nothing", "unknown estimator 'nothing': choose one of slip"),
        ("a b:c", "unknown estimator"),
        ("no_such_package.x:Y", "there is no module no_such_package; install .* or start the rig"),
        (f"{MODULE}:Min", r"has no such name \(did you mean 'Mine'\?\); its classes: Mine, Arguments"),
        (f"{MODULE}:function", "has a builtin_function_or_method of that name; its classes: Mine"),
        (f"{MODULE}.py:Mine", f"give module:Class without .py, as {MODULE}:Mine"),
        ("bad.py:Mine", "there is no file bad.py; give module:Class without .py, as bad:Mine"),
        ("./bad.py:Mine", "there is no file bad.py; give module:Class without .py, as bad:Mine"),
        ("lab/bad.py:Mine", "there is no file lab/bad.py; give .* as bad:Mine and start the rig in lab"),
        ("bad.py", "there is no file bad.py; give module:Class without .py, as bad:Class"),
        (f"{MODULE}:No_update", r"has no method update\(image, time_ns\)"),
    ],
)
def test_invalid_estimator_name_is_rejected(imported: Path, name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        choose_estimator(name)


def test_failing_import_is_reported_with_its_reason(imported: Path) -> None:
    for number, (text, why) in enumerate(
        [("import lab_weights", "ModuleNotFoundError: No module named 'lab_weights'"),
         ("1/0", "ZeroDivisionError: division by zero"), ("raise SystemExit(3)", "SystemExit: 3"),
         ("class A", "SyntaxError: expected ':'")]
    ):  # fmt: skip
        file = imported.with_name(f"broken_{number}.py")
        file.write_text(text)
        place = f"importing broken_{number} failed ({why} ({file}, line 1: {text})); correct it"
        with pytest.raises(InputError, match=re.escape(place)):
            choose_estimator(f"broken_{number}:Any")


def test_constructor_error_is_raised_before_a_lift(imported: Path) -> None:
    with pytest.raises(EstimatorError, match=r"Needs_more\(background\) raised TypeError: .*weights"):
        choose_estimator(f"{MODULE}:Needs_more").try_making()
    choose_estimator(f"{MODULE}:Mine").try_making()
    choose_estimator("slip").try_making()


def test_constructor_gets_aspect_and_sign_and_answers_become_floats(imported: Path) -> None:
    sample = choose_estimator(f"{MODULE}:Arguments").make(GEL, aspect=1.25, sign=-1).update(GEL, 0)
    assert (sample.angle_deg, sample.sigma_deg) == (1.25, 1.0)
    assert {type(sample.angle_deg), type(sample.sigma_deg)} == {float}
    assert list(sample.stage_s) == ["update"]
    frame = GEL.copy()
    choose_estimator(f"{MODULE}:Numpy").make(GEL).update(frame, 0)
    assert np.array_equal(frame, GEL), "an estimator cannot change the frame"


def test_frame_with_an_exception_is_lost_and_the_others_are_answered(imported: Path) -> None:
    samples = answers("Now_and_then", 30)
    assert [sample.state for sample in samples].count(State.LOST) == 3
    file = imported.with_name(f"{MODULE}.py")
    code = 'raise ValueError("no gradient today")'
    line = file.read_text().splitlines().index(f"            {code}") + 1
    assert faults_of(samples) == EstimatorFaults(
        3,
        f"{MODULE}:Now_and_then: update() raised ValueError: no gradient today ({file}, line {line}: {code})",
    )


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("In_a_library", (f"{MODULE}.py, line ", "np.linalg.inv(np.zeros((2, 2))))")),
        (
            "Nan",
            ("angle_deg is nan, not a finite number",),
        ),  # pytest would turn NumPy's warning into an error
    ],
)
def test_error_in_numpy_names_the_line_of_the_user(imported: Path, name: str, words: tuple[str, ...]) -> None:
    (sample,) = answers(name, 1)
    assert all(word in str(sample.fault) for word in words)


def test_invalid_samples_are_lost_with_a_reason(imported: Path) -> None:
    samples = answers("Rubbish", 16)
    assert all(sample.state is State.LOST and sample.angle_deg is None for sample in samples)
    messages = [str(sample.fault) for sample in samples]
    words = (
        "NoneType", "float", "time_ns", "dict", "angle_deg is nan", "'12'", "True",
        "not a rig.tactile.sample.State", "below 0", "not a pair", "contact_area_px is None",
        "inf", "pixels", "no_contact", "stage_s", "skipped",
    )  # fmt: skip
    assert all(word in text for word, text in zip(words, messages, strict=True)), messages


def test_estimator_gets_each_frame_once_and_of_one_size(imported: Path) -> None:
    estimator = choose_estimator(f"{MODULE}:Now_and_then").make(GEL)
    for _ in range(40):
        assert estimator.update(GEL, 0).fault is None
    with pytest.raises(InputError, match="use one size"):
        estimator.update(GEL[:-1], STEP_NS)


def test_operator_stop_is_not_caught(imported: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    estimator = choose_estimator(f"{MODULE}:Mine").make(GEL)
    stopped = Mock(side_effect=OperatorStopError("Ctrl-C"))
    monkeypatch.setattr(sys.modules[MODULE].Mine, "update", stopped)
    with pytest.raises(OperatorStopError):
        estimator.update(GEL, 0)
