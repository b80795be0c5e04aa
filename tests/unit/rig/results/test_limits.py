"""Limits: read from files, checked by name, unit and object, and compared with lifts and session."""

import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from drivers.errors import InputError
from rig.config import load_bench
from rig.config.models import LimitConfig
from rig.report.write import write_page
from rig.results.limits import apply_limits, checked_limits, json_lines, junit_xml, limit_rows, read_limits
from rig.sessions.records import ClockLag, ErrorSummary, Lift, LiftTiming, StageTimes
from support.command_line import rig
from support.quick_lifts import quick_lifts

OBJECTS = ["t1", "7"]


MakeRow = Callable[..., Lift]


@pytest.fixture
def rows(lift_row: MakeRow) -> list[Lift]:
    """Two lifts of the wrench, and one of spam without an answer."""
    errors = [ErrorSummary(mean_deg, 0.1, mean_deg + 0.1, 100) for mean_deg in (0.5, 1.5)]
    wrench = [lift_row(n, lift=n, object="t1", name="wrench", re=re) for n, re in enumerate(errors, 1)]
    return [*wrench, lift_row(3, lift=3, object="7", name="spam", re=None, answered=0.0)]


def verdicts(rows: list[Lift], **limit: object) -> list[tuple[str, float | None, bool]]:
    found = apply_limits(checked_limits((LimitConfig(**limit),), OBJECTS), rows)
    return [(one.of, one.value, one.met) for one in found]


def test_each_accepted_lift_is_compared_and_one_without_the_figure_misses(rows: list[Lift]) -> None:
    assert verdicts(rows, figure="re_mean_deg", upper=1.0) == [
        ("wrench, lift 1", 0.5, True),
        ("wrench, lift 2", 1.5, False),
        ("spam, lift 3", None, False),
    ]
    failed = replace(rows[1], accepted=False, fault="arm: lost")
    assert len(verdicts([*rows, failed], figure="re_mean_deg", upper=1.0)) == 3


def test_sigma_delay_and_time_per_frame_have_limits(rows: list[Lift]) -> None:
    lift = replace(rows[0], sigma_b_p95_deg=0.8, lag=ClockLag(-0.02, 0.001))
    timing = LiftTiming(number=1, attempt=0, wall_s=3.0, stages={"total": StageTimes(2.0, 3.0, 4.0)})
    limits = (
        LimitConfig(figure="sigma_b_p95_deg", upper=0.5, unit="deg"),
        LimitConfig(figure="lag_s", lower=-0.05, upper=0.05, unit="s"),
        LimitConfig(figure="frame_p99_ms", upper=3.0, unit="ms"),
    )
    found = apply_limits(checked_limits(limits, OBJECTS), [lift], [timing])
    assert [(one.value, one.met) for one in found] == [(0.8, False), (-0.02, True), (4.0, False)]
    assert not any(one.met for one in apply_limits(limits, [rows[0]])), "a figure without a value misses"


def test_limit_of_one_object_is_for_its_lifts_only(rows: list[Lift]) -> None:
    assert [of for of, *_ in verdicts(rows, figure="answered", lower=0.9, object="wrench")] == [
        "wrench, lift 1",
        "wrench, lift 2",
    ]
    assert verdicts(rows, figure="mare_deg", lower=0.9, upper=1.1, object="t1") == [("wrench", 1.0, True)]


def test_session_figures_have_one_verdict(rows: list[Lift]) -> None:
    assert verdicts(rows, figure="mare_deg", upper=0.9) == [("session", 1.0, False)]
    assert verdicts(rows, figure="lifts_refused", upper=0) == [("session", 1, False)]


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        ({"figure": "re_mean_degg", "upper": 1.0}, "did you mean 're_mean_deg'"),
        (
            {"figure": "re_mean_deg", "upper": 1.0, "unit": "rad"},
            "re_mean_deg is in 'deg', and the limit is in 'rad'",
        ),
        (
            {"figure": "answered", "lower": 1.0, "unit": "deg"},
            "answered has no unit, and the limit is in 'deg'",
        ),
        ({"figure": "re_mean_deg", "upper": 1.0, "object": "mustard"}, "object mustard is not lifted"),
    ],
)
def test_limit_that_cannot_apply_is_refused(limit: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=words):
        checked_limits((LimitConfig(**limit),), OBJECTS)


def test_limits_of_a_bench_file_are_for_all_trials() -> None:
    limits = tuple(LimitConfig(figure="re_mean_deg", upper=1.0, object=of) for of in ("mustard", OBJECTS[0]))
    assert [of.object for of in checked_limits(limits, OBJECTS, all_apply=False)] == [OBJECTS[0]]
    with pytest.raises(InputError, match="mustrd"):
        checked_limits((limits[0].model_copy(update={"object": "mustrd"}),), OBJECTS, all_apply=False)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "limits: is missing"),
        ("limits = []\nupperr = 0.2", r"l.toml:2: upperr: unknown key \(did you mean 'upper'\?\)"),
        ('[[limit]]\nfigure = "answered"\nlower = 1\n', "l.toml:1: limit: unknown key .did you mean"),
        ("limits = 3", "l.toml:1: limits: must be a list, found 3"),
        ("[[limits]]\nfigure = { of = 1 }\nupper = 1.0", "must be text in quotation marks, found a table"),
        ('[[limits]]\nfigure = "answered"\n', "needs lower, upper or both"),
        ('[[limits]]\nfigure = "answered"\nlower = 2\nupper = 1\n', "lower is above upper"),
        ('[[limits]]\nfigure = "answered"\nlowest = 2\n', "l.toml:3: limits.0.lowest: .*mean 'lower'"),
        ('[[limits]]\nfigure = "answered"\nlower = "much"\n', "number"),
    ],
)
def test_invalid_file_is_refused_with_the_key_in_the_words_of_the_file(
    text: str, words: str, tmp_path: Path
) -> None:
    (tmp_path / "l.toml").write_text(text)
    with pytest.raises(InputError, match=words) as raised:
        read_limits(tmp_path / "l.toml")
    assert not re.search(r"column|[Tt]uple|\bdict\b|Input should|validation", str(raised.value))


def test_verdicts_as_rows_json_lines_and_junit(rows: list[Lift]) -> None:
    limits = checked_limits((LimitConfig(figure="re_mean_deg", upper=1.0, unit="deg"),), OBJECTS)
    found = apply_limits(limits, rows)
    assert limit_rows(found) == [("re_mean_deg", "at most 1 deg", "1 of 3", "wrench, lift 2: 1.5 deg")]
    assert [json.loads(line)["met"] for line in json_lines(found).splitlines()] == [True, False, False]
    suite = ElementTree.fromstring(junit_xml(found, "s"))
    assert (suite.get("tests"), suite.get("failures")) == ("3", "2")
    messages = [failure.get("message") for failure in suite.iter("failure")]
    assert messages[0] == "wrench, lift 2: re_mean_deg 1.5 deg, required at most 1 deg"


def test_names_that_xml_cannot_contain_are_replaced(rows: list[Lift], tmp_path: Path) -> None:
    limits = checked_limits((LimitConfig(figure="re_mean_deg", upper=1.0),), OBJECTS)
    folder = os.fsdecode(b"M\xfcller \x1b")  # written by a system with Latin-1 names
    text = junit_xml(apply_limits(limits, rows), folder)
    assert ElementTree.fromstring(text.encode()).get("name") == "M\ufffdller \ufffd"
    write_page(tmp_path / "page.html", f"<h1>{folder}</h1>")
    assert (tmp_path / "page.html").read_bytes() == b"<h1>M?ller \x1b</h1>"


def test_bench_file_may_have_limits(light_bench_file: Path, tmp_path: Path) -> None:
    file = tmp_path / "bench.toml"
    file.write_text(light_bench_file.read_text() + '\n[[limits]]\nfigure = "answered"\nlower = 0.9\n')
    assert load_bench(str(file)).limits == (LimitConfig(figure="answered", lower=0.9),)


@pytest.mark.heavy
@pytest.mark.usefixtures("quick_pages")
def test_trial_with_limits_says_which_lift_misses_and_why(
    light_bench_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    quick_lifts(monkeypatch)
    file = tmp_path / "limits.toml"
    file.write_text(
        '[[limits]]\nfigure = "re_max_deg"\nupper = 0.001\n[[limits]]\nfigure = "answered"\nlower = 0.1\n'
    )
    what = ("--object", "t2", "--lifts", 1, "--jobs", 1)
    trial = ("trial", "--bench", light_bench_file, *what, "--out", tmp_path / "s")
    done = rig(*trial, "--limits", file, "--json")
    assert done.returncode == 4, done.stderr
    assert "rig: limit missed: toothbrush, lift 1: re_max_deg" in done.stderr
    assert [one["met"] for one in json.loads(done.stdout)["limits"]] == [False, True]
    assert "limits: 1 of 2 missed" in done.stderr
    assert len((tmp_path / "s/limits.jsonl").read_text().splitlines()) == 2
    assert "Limits" in (tmp_path / "s/report.html").read_text()
    again = rig(*trial, "--resume", "--no-report", "--limits", file)
    assert again.returncode == 4
    kept = rig(*trial, "--resume", "--no-report")
    assert kept.returncode == 4, "limits that are not given again stay those of the session"
    file.write_text('[[limits]]\nfigure = "answered"\nlower = 0.1\n')
    assert rig(*trial, "--resume", "--no-report", "--limits", file).returncode == 0, "limits may change"
    file.write_text('[[limits]]\nfigure = "answer"\nlower = 0.1\n')
    assert "did you mean 'answered'" in rig(*trial, "--resume", "--limits", file).stderr
