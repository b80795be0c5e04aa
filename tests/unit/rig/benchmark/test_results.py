"""What a run of the benchmark leaves: figures, picture, page, and the README's table."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

import rig.benchmark.estimators.study as study
from drivers.errors import InputError, SessionError
from rig.benchmark.estimators import contenders
from rig.benchmark.estimators.contenders import CONTENDERS, WINDOWS
from rig.benchmark.estimators.stress import run_stress, stress_rows
from rig.benchmark.estimators.study import EstimatorsResult
from rig.benchmark.harness import Report, Run, check_readme, markers
from rig.benchmark.timing import REFERENCE
from rig.experiments.lift_plan import stored_trial
from rig.experiments.replay import replay_lift
from rig.sessions.rows import read_finished_lifts
from support.benches import lighter, short_phases

DOCUMENT = Path(__file__).resolve().parents[4] / "docs" / "measurements.md"
BEGIN, END = markers("estimators")


PROGRESS: list[str] = []


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> EstimatorsResult:
    """One lift of one object with few frames, no stress: the smallest run that has all other parts."""

    def show(done: int, total: int, note: str) -> None:
        PROGRESS.append(f"{done}/{total} {note}")

    run = Run(jobs=1, folder=tmp_path_factory.mktemp("benchmark"), progress=show)
    with short_phases(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(contenders, "FRAMES_PER_LIFT", 30)
        patch.setattr(study, "load_bench", partial(lighter, tip_hz=12.0))
        patch.setattr(study, "TRIAL_OBJECTS", ("t2",))
        patch.setattr(study, "LIFTS", 1)
        patch.setattr(study, "stress_tasks", lambda: [])
        return study.compare(study.EstimatorsOptions(estimator=["kolamuri"]), run)


@pytest.fixture(scope="module")
def report(result: EstimatorsResult) -> Report:
    return study.report_of(result)


@pytest.mark.heavy
@pytest.mark.usefixtures("result")
def test_progress_names_each_step() -> None:
    recorded, *others = PROGRESS
    assert recorded.startswith("1/1 session: t2/1 ")
    assert others == ["1/1 timed on lift t2/1", "1/1 estimators on t2/1"]


@pytest.mark.heavy
def test_benchmark_scores_a_lift_as_in_the_trial(result: EstimatorsResult) -> None:
    rows = read_finished_lifts(result.session)
    for name, window in (("slip", 1), ("pca", 4)):
        settings = stored_trial(result.session, name, window).settings
        row, _ = replay_lift(result.session, settings, rows[0])
        score = result.scores[name, window]
        found = [score.mare.mean_deg, score.mare.std_deg, score.mare_b.mean_deg, score.answered]
        expected = [row.re.mean_deg, row.re.std_deg, row.re_b.mean_deg, row.answered]
        assert found == pytest.approx(expected, abs=1e-9)


@pytest.mark.heavy
def test_every_estimator_has_every_window_from_one_pass(result: EstimatorsResult, report: Report) -> None:
    assert set(result.scores) == {(name, window) for name in (*CONTENDERS, "kolamuri") for window in WINDOWS}
    assert set(result.timing.contenders) == {*CONTENDERS, "kolamuri", REFERENCE}
    assert report.faults == {}
    for name, of in result.timing.contenders.items():
        assert 0.0 < of.contact.p50_ms <= of.contact.p99_ms <= of.contact.max_ms
        if name != REFERENCE:
            assert of.contact.count < of.frames
            assert of.stages["contact"].count == of.contact.count


@pytest.mark.heavy
def test_limit_without_measurement_is_missed(result: EstimatorsResult, report: Report) -> None:
    limits = {limit.name: limit for limit in report.limits}
    assert len(limits) == 10
    assert [name for name, limit in limits.items() if limit.met is None] == [
        "frame with contact in to angle out, median, ms",
        "frame with contact in to angle out, 99th percentile, ms",
    ]
    assert limits["share of frames answered"].met
    refused = limits["share of frames refused on smooth round contacts"]
    assert (refused.value, refused.met) == (None, False)  # this run has no stress part
    small = replace(result.timing, size_px=(64, 48))  # no limit for this size
    bad = study.judge(replace(result, timing=small))
    assert "times as fast as the published second stage" in {v.name for v in bad if not v.met}


@pytest.mark.heavy
def test_result_files_and_documentation_contain_all_figures(result: EstimatorsResult, report: Report) -> None:
    assert len(report.figures["estimators"]) == len(result.scores)
    assert report.files[study.TABLE] == report.section + "\n"
    check_readme(DOCUMENT, "estimators")
    section = DOCUMENT.read_text(encoding="utf-8").partition(BEGIN)[2].partition(END)[0]
    for text in (section, report.section):
        heading = next(line for line in text.splitlines() if line.startswith("|"))
        columns = tuple(cell.strip() for cell in heading.strip("|").split("|"))
        assert columns == study.estimator_table(result).columns[: study.README_COLUMNS]


@pytest.mark.heavy
def test_tables_have_a_cell_per_column(result: EstimatorsResult) -> None:
    balls = replace(result, stress=stress_rows(run_stress(0, ("slip",), ("round", "3:0"))))
    for table in (study.estimator_table(result), study.stress_table(balls)):
        assert table.rows
        assert {len(row) for row in table.rows} == {len(table.columns)}
    assert {row[2] for row in study.stress_table(balls).rows} == {"refused 100%"}
    assert study.estimator_table(result).rows[-1][0] == "kolamuri"


@pytest.mark.parametrize("text", ["", BEGIN, f"{END}{BEGIN}", f"{BEGIN}{END}{BEGIN}"])
def test_document_without_markers_is_rejected(text: str, tmp_path: Path) -> None:
    readme = tmp_path / "README.md"
    readme.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match="put these two lines"):
        check_readme(readme, "estimators")


def test_folder_without_a_session_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(SessionError):
        study.compare(study.EstimatorsOptions(session=tmp_path), Run())
