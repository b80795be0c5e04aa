"""What a run of the benchmark leaves: figures, picture, page, and the README's table."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import rig.benchmark.estimators.benchmark as benchmark
import rig.benchmark.estimators.timing as timing
from drivers.errors import InputError, SessionError
from rig.benchmark.estimators.benchmark import BenchmarkResult, BenchmarkSettings, as_json, run_benchmark
from rig.benchmark.estimators.contenders import CONTENDERS, NO_SKIP, WINDOWS
from rig.benchmark.estimators.files import check_writable, write_results
from rig.benchmark.estimators.limits import judge
from rig.benchmark.estimators.picture import Point, pareto, spread_labels
from rig.benchmark.estimators.stress import StressTask, run_stress, stress_rows
from rig.benchmark.estimators.tables import NAME, README_COLUMNS, estimator_table, stress_table
from rig.benchmark.readme import check_readme, markers
from rig.experiments.replay import replay_with_angles
from rig.experiments.stored_trial import stored_trial
from rig.sessions.rows import read_finished_lifts
from support.benches import lighter

PAGE = Path(__file__).resolve().parents[4] / "docs" / "estimators.md"
BEGIN, END = markers(NAME)


Told = list[tuple[str, int, int]]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[BenchmarkResult, Told]:
    """One lift of one object with half the frames, no stress: the smallest run that has all other parts."""
    told: Told = []

    def show(part: str, done: int, total: int, note: str) -> None:
        told.append((part, done, total))

    out = tmp_path_factory.mktemp("benchmark")
    settings = BenchmarkSettings(out, objects=("t2",), lifts=1, jobs=1, groups=(), more=("kolamuri",))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timing, "FRAMES_PER_LIFT", 120)
        patch.setattr(benchmark, "load_bench", lighter)
        return run_benchmark(settings, show), told


@pytest.fixture(scope="module")
def result(run: tuple[BenchmarkResult, Told]) -> BenchmarkResult:
    return run[0]


def test_progress_names_the_part_and_how_far_it_is(run: tuple[BenchmarkResult, Told]) -> None:
    assert run[1] == [("lifts", 1, 1), ("timing", 1, 1), ("estimators", 1, 1)]


def test_the_benchmark_scores_a_lift_as_the_trial_does(result: BenchmarkResult) -> None:
    rows = read_finished_lifts(result.session)
    for name, window in (("slip", 1), ("pca", 4)):
        row = replay_with_angles(
            result.session, stored_trial(result.session, name, window).settings, rows[0]
        )[0]
        score = result.scores[name, window]
        assert score.mare is not None
        assert score.mare_b is not None
        assert row.re is not None
        assert row.re_b is not None
        assert score.mare.mean_deg == pytest.approx(row.re.mean_deg, abs=1e-9)
        assert score.mare.std_deg == pytest.approx(row.re.std_deg, abs=1e-9)
        assert score.mare_b.mean_deg == pytest.approx(row.re_b.mean_deg, abs=1e-9)
        assert score.answered == row.answered


def test_every_estimator_has_every_window_from_one_pass(result: BenchmarkResult) -> None:
    assert set(result.scores) == {
        (name, window)
        for name in (*CONTENDERS, "kolamuri")
        for window in WINDOWS
        if name != NO_SKIP or window == 1
    }
    assert set(result.timing.contenders) == {*CONTENDERS, "kolamuri"}
    assert result.faults == {}
    for of in result.timing.contenders.values():
        assert 0.0 < of.contact.p50_ms <= of.contact.p99_ms <= of.contact.max_ms
        assert of.contact.count < of.frames
        assert of.stages["contact"].count == of.contact.count


def test_limits_are_judged_and_nothing_to_measure_is_no_success(result: BenchmarkResult) -> None:
    limits = {limit.name: limit for limit in result.limits}
    assert len(limits) == 12
    assert limits["share of frames answered"].met
    refused = limits["share of frames refused on smooth round contacts"]
    assert (refused.value, refused.met) == (None, False)  # this run has no stress part
    bad = judge(result.scores, result.timing, 0.5, 3, [])
    assert "largest difference of skipping and --no-skip, deg" in {v.name for v in bad if not v.met}


def test_files_hold_the_figures_and_need_nothing_else(result: BenchmarkResult, tmp_path: Path) -> None:
    readme = tmp_path / "README.md"
    readme.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    write_results(tmp_path, result, readme)
    stored = json.loads((tmp_path / "results.json").read_text())
    assert stored == json.loads(json.dumps(as_json(result)))
    assert len(stored["estimators"]) == len(result.scores)
    picture = cv2.imread(str(tmp_path / "pareto.png"))
    assert picture is not None
    assert picture.std() > 5
    page = (tmp_path / "index.html").read_text()
    assert "SIMULATED" in page
    assert not re.search(r'(src|href)="(?!data:|#)', page)
    assert all(name in page for name in CONTENDERS)
    text = readme.read_text()
    assert text.startswith("before\n")
    assert text.endswith("\nafter\n")
    assert "old" not in text
    assert (tmp_path / "table.md").read_text().strip() in text
    assert table_columns(text) == README_COLUMNS


def test_tables_have_a_cell_per_column(result: BenchmarkResult) -> None:
    balls = replace(result, stress=stress_rows(run_stress(StressTask("round", "3:0", 0, False))))
    for table in (estimator_table(result), estimator_table(result, windows=True), stress_table(balls)):
        assert table.rows
        assert {len(row) for row in table.rows} == {len(table.columns)}
    assert {row[2] for row in stress_table(balls).rows} == {"refused 100%"}
    assert estimator_table(result).rows[-1][0] == "kolamuri"


def test_the_documentation_has_the_benchmarks_table() -> None:
    check_readme(PAGE, NAME)
    assert table_columns(PAGE.read_text(encoding="utf-8")) == README_COLUMNS


def table_columns(text: str) -> tuple[str, ...]:
    section = text.partition(BEGIN)[2].partition(END)[0]
    heading = next(line for line in section.splitlines() if line.startswith("|"))
    return tuple(cell.strip() for cell in heading.strip("|").split("|"))


@pytest.mark.parametrize("text", ["", BEGIN, f"{END}{BEGIN}", f"{BEGIN}{END}{BEGIN}"])
def test_a_readme_without_markers_is_refused_before_the_run(text: str, tmp_path: Path) -> None:
    readme = tmp_path / "README.md"
    readme.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="put these two lines"):
        check_writable(tmp_path, readme)


def test_an_unwritable_folder_is_refused_before_the_run(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="choose another --out"):
        check_writable(tmp_path / "file" / "out", None)


def test_a_session_that_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SessionError):
        run_benchmark(BenchmarkSettings(tmp_path, session=tmp_path))


def test_the_front_has_what_nothing_beats_in_both() -> None:
    def point(time_ms: float, error: float) -> Point:
        return Point("slip", time_ms, {1: error})

    fast, close, beaten, middle = point(1, 5), point(9, 1), point(9, 5), point(3, 2)
    assert pareto([close, beaten, middle, fast]) == [fast, middle, close]


@given(st.lists(st.floats(-0.5, 1.5), min_size=1, max_size=12))
def test_labels_keep_apart_in_order_and_inside(places: list[float]) -> None:
    gap = 0.06
    moved = spread_labels(places, gap)
    order = sorted(range(len(places)), key=lambda i: (places[i], moved[i]))
    steps = np.diff([moved[i] for i in order])
    assert (steps >= gap - 1e-9).all()
    assert -1e-9 <= min(moved) <= max(moved) <= 1.0 + 1e-9
