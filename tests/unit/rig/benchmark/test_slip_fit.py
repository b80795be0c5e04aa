"""The fit of slip's parameters: the likelihood, its gain, the steps, and the search on small cases."""

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import InputError
from rig.benchmark import renderer
from rig.benchmark import slip_fit as study
from rig.benchmark.clips.labelled import ClipLabel, ClipVersion, LabelledClip
from rig.benchmark.estimators.contenders import KnownLift
from rig.benchmark.harness import Run
from rig.benchmark.renderer import LIFT_NS
from rig.frames.series import FrameSeries
from rig.tactile.slip.parameters import GROUPS, shipped, use

LIFT = 900
RATE_HZ, REFERENCE, FIRST_FRAMES = 20.0, 19, 34


@cache
def lift_of(number: int) -> KnownLift:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(renderer, "RATE_HZ", RATE_HZ)
        return renderer.drawn_lift(number)


def clip(name: str) -> LabelledClip:
    """Frames of a rendered lift as a labelled clip."""
    tip = lift_of(LIFT).tips["0"]
    series = FrameSeries(name, lambda: islice(tip.frames, FIRST_FRAMES))
    truth_deg, last = lift_of(LIFT).truth.angle_deg, FIRST_FRAMES - 1
    label = ClipLabel(last, float(truth_deg[last] - truth_deg[REFERENCE]), 1.0)
    return LabelledClip(name, "all", series, tip.background, REFERENCE, (label,))


@given(st.floats(-60.0, 60.0), st.floats(0.01, 40.0), st.floats(-60.0, 60.0), st.floats(0.0, 5.0))
def test_likelihood_is_best_for_a_correct_angle_and_bounded_for_a_wrong_one(
    angle: float, sigma: float, true: float, true_sigma: float
) -> None:
    found = study.surprise(angle, sigma, true, true_sigma)
    assert found >= study.surprise(true, sigma, true, true_sigma)
    assert found <= math.log(120.0 / 0.01) + 1e-9


def test_small_sigma_is_likelier_than_a_large_one_only_if_the_angle_is_correct() -> None:
    assert study.surprise(10.0, 1.0, 10.0, 0.0) < study.surprise(10.0, 5.0, 10.0, 0.0)
    assert study.surprise(20.0, 1.0, 10.0, 0.0) > study.surprise(20.0, 5.0, 10.0, 0.0)
    assert study.surprise(None, None, 10.0, 0.0) < study.surprise(30.0, 1.0, 10.0, 0.0)


def test_gain_counts_versions_of_a_clip_once_and_clips_as_much_as_all_lifts() -> None:
    clips, *lifts = study.Kind
    cases = [study.Case(clips, unit, Path(unit + of)) for unit in "ab" for of in ("", " mirrored")]
    cases += [study.Case(kind, f"{kind} {n}", Path(f"{kind} {n}")) for kind in lifts for n in (1, 2)]
    before = {case.folder: 2.0 for case in cases}
    all_better = {case.folder: 1.0 for case in cases}
    assert study.gain_of(cases, before, all_better) == pytest.approx((1.0, 0.0))
    clips_only = {case.folder: 1.0 if case.kind is clips else 2.0 for case in cases}
    assert study.gain_of(cases, before, clips_only)[0] == pytest.approx(0.5)
    one_clip = {case.folder: 0.0 if case.unit == "a" else 2.0 for case in cases}
    assert study.gain_of(cases, before, one_clip) == pytest.approx((0.5, 0.5))


def test_every_parameter_can_be_stepped_in_both_directions_and_back() -> None:
    for group, short in ((group, short) for group, of in shipped().items() for short in of):
        name, value = f"{group}.{short}", shipped()[group][short]
        assert value == getattr(GROUPS[group], short) > 0.0  # the estimator uses it
        less, more = (study.stepped(value, name, factor) for factor in (1.0 / study.STEP, study.STEP))
        assert 0.0 < less < value < more, name
        if short in study.COUNTS:
            assert all(each == int(each) for each in (less, value, more)), name
        else:
            assert study.stepped(more, name, 1.0 / study.STEP) == pytest.approx(value), name
        if short in study.FRACTIONS or short.endswith("share"):
            assert more < 1.0, name


def test_every_group_fraction_and_count_is_shipped() -> None:
    names = {name: {*of} for name, of in shipped().items()}
    assert names == {name: {*of.__slots__} for name, of in GROUPS.items()}
    assert study.FRACTIONS | study.COUNTS <= set().union(*names.values())


@pytest.fixture(autouse=True)
def parameters_restored() -> Iterator[None]:
    yield
    use(shipped())


@pytest.mark.heavy
def test_penalty_of_stored_cases_depends_on_the_parameters(tmp_path: Path) -> None:
    case = study.store(study.Case(study.Kind.CLIP, "clip", tmp_path / "clip"), study.clip_lift(clip("clip")))
    assert case.stored
    values = shipped()
    usual = study.penalty((values, case))
    assert usual < 4.0
    vague = values | {"sigma": values["sigma"] | {"least_rad": 20.0}}
    assert study.penalty((vague, case)) > usual


@pytest.mark.heavy
def test_rendered_lift_is_scored_at_both_fingertips_and_fused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(study, "drawn_lift", lift_of)
    case = study.store_rendered(tmp_path, LIFT)
    truth = np.load(case.folder / "truth.npz")
    assert int(truth["zero_ns"]) == LIFT_NS
    assert study.penalty((shipped(), case)) < 4.0


@pytest.mark.heavy
def test_fit_keeps_what_it_has_tried_and_goes_on_with_resume(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def penalty(task: tuple[study.Values, study.Case]) -> float:
        return abs(math.log(task[0]["keyframes"]["richer"] / (study.STEP * shipped()["keyframes"]["richer"])))

    monkeypatch.setattr(study, "penalty", penalty)
    clips = [clip("one"), clip("two")]
    monkeypatch.setattr(study, "read_clips", lambda *_: clips)
    monkeypatch.setattr(study, "ClipVersion", [ClipVersion.PLAIN])
    monkeypatch.setattr(study, "LIFTS_OF_RENDERER", 0)
    monkeypatch.setattr(study, "resolve_objects", lambda *_: [])
    options = study.FitOptions(tmp_path, only=["keyframes.richer"], lifts=1, save=tmp_path / "slip.json")
    run = Run(jobs=1, folder=tmp_path / "fit")
    study.measure(options, run)
    card = json.loads((tmp_path / "slip.json").read_text())
    assert card["mean_negative_log_likelihood"][0]["cases"] == 2
    assert set(card["parameters"]) == set(GROUPS)
    tried = (tmp_path / "fit" / study.TRIED).read_text().splitlines()
    assert len(tried) >= 2
    richer = shipped()["keyframes"]["richer"]
    assert card["parameters"]["keyframes"]["richer"] == pytest.approx(study.STEP * richer)
    with pytest.raises(InputError, match="--resume"):
        study.measure(options, run)
    report = study.measure(
        replace(options, only=["keyframes.richer", "keyframes.further_rad"]), replace(run, resume=True)
    )
    assert len((tmp_path / "fit" / study.TRIED).read_text().splitlines()) > len(tried)
    found = {row["parameter"] for row in report.tables[1].records}
    assert found == {"keyframes.richer", "keyframes.further_rad"}


def test_unknown_parameter_is_named_with_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"keyframes\.richer"):
        study.measure(study.FitOptions(tmp_path, only=["keyframes.richr"]), Run())
