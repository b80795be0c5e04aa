"""Files for a paper: sizes, names, and the numbers of the page."""

import csv
import io
import re
from pathlib import Path
from typing import Any

import cv2
import pytest

from drivers.errors import InputError
from rig.report.parts import Table
from rig.report.session import read_trial
from rig.report.trial_page import object_table
from rig.report.write import latex, write_report
from rig.results.summary import summarize_trial
from rig.sessions.manifest import TrialManifest, read_manifest_of

COLUMN_PT = 88.9 / 25.4 * 72


@pytest.fixture(scope="module")
def written(drawn_trial: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A session and the folder with its figures."""
    folder = tmp_path_factory.mktemp("paper")
    session = drawn_trial(folder / "session", (12.0,))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rig.report.explored.lift_film", lambda *_: None)
        write_report([session], figures=folder / "made" / "figures")
    return session, folder / "made" / "figures"


@pytest.mark.heavy
def test_figures_of_the_page_are_written_in_three_formats_as_wide_as_a_column(
    written: tuple[Path, Path],
) -> None:
    names = {path.name for path in written[1].iterdir()}
    for stem in ("Rotational_error_per_object", "Error_against_angle", "wrench_lift_1"):
        assert {f"simulated_{stem}.{ending}" for ending in ("pdf", "svg", "png")} <= names
    for path in written[1].glob("*.pdf"):
        (in_pdf,) = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+)", path.read_bytes())
        (in_svg,) = re.findall(r'<svg[^>]* width="([\d.]+)pt"', path.with_suffix(".svg").read_text())
        assert [float(in_pdf), float(in_svg)] == pytest.approx([COLUMN_PT] * 2, abs=0.1)
        picture = cv2.imread(str(path.with_suffix(".png")))
        assert picture is not None
        assert picture.shape[1] == pytest.approx(600 * 88.9 / 25.4, abs=1)


@pytest.mark.heavy
def test_tables_hold_the_numbers_of_the_page(written: tuple[Path, Path]) -> None:
    session, folder = written
    trial = read_trial(session, read_manifest_of(session, TrialManifest, "no trial"))
    table = object_table(summarize_trial(trial.rows))
    rows = list(csv.reader(io.StringIO((folder / "simulated_rotational_error.csv").read_text())))
    assert rows == [list(table.columns), *(list(row) for row in table.rows)]
    page = (session / "report.html").read_text()
    source = (folder / "simulated_rotational_error.tex").read_text()
    assert source.startswith("% SIMULATED")
    for row in table.rows:
        assert all(f">{cell}<" in page for cell in row)
        assert " & ".join(row).replace("±", r"$\pm$").replace("%", r"\%") + r" \\" in source


def test_special_characters_are_escaped_in_latex() -> None:
    source = latex(Table(("a_b", "50 %"), [["x&y", "{$1^2~"]]), simulated=False)
    assert r"a\_b & 50 \% \\" in source
    assert r"x\&y & \{\$1\textasciicircum{}2\textasciitilde{} \\" in source


@pytest.mark.heavy
def test_sources_without_figures_for_a_paper_are_rejected(drawn_recording: Any, tmp_path: Path) -> None:
    session = drawn_recording(tmp_path / "session")
    with pytest.raises(InputError, match="only readable trials and CSV files"):
        write_report([session], figures=tmp_path / "figures")
    assert not (tmp_path / "figures").exists()
