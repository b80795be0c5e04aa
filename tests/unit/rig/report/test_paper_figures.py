"""Files for a paper: sizes, names, and the numbers of the page."""

import csv
import io
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb

from drivers.errors import InputError
from rig.pages.figure import legend_outside
from rig.pages.palette import ESTIMATE, PAPER, PHASE
from rig.report.charts import lift_chart
from rig.report.parts import Table
from rig.report.session import read_trial
from rig.report.trial_page import object_table
from rig.report.write import latex, write_report
from rig.results.summary import summarize_trial
from rig.sessions.manifest import TrialManifest, read_manifest_of
from rig.version import version_text

COLUMN_PT = 88.9 / 25.4 * 72


@pytest.fixture(scope="module")
def written(drawn_trial: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A session and the folder with its figures."""
    folder = tmp_path_factory.mktemp("paper")
    session = drawn_trial(folder / "session", (12.0,))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("rig.report.explored.lift_film", lambda *_: None)
        done = write_report([session], folder / "report.html", figures="all")
    assert done.figures == folder / "figures"
    return session, done.figures


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
    page = (folder.parent / "report.html").read_text()
    source = (folder / "simulated_rotational_error.tex").read_text()
    assert source.startswith("% SIMULATED")
    assert "% \u00b1: mean over the lifts of each lift's standard deviation, not a standard error" in source
    for row in table.rows:
        assert all(f">{cell}<" in page for cell in row)
        assert " & ".join(row).replace("±", r"$\pm$").replace("%", r"\%") + r" \\" in source


@pytest.mark.heavy
def test_captions_name_every_file_with_commit_command_and_bibtex(written: tuple[Path, Path]) -> None:
    session, folder = written
    text = (folder / "captions.txt").read_text()
    stems = {path.stem for path in folder.iterdir()} - {"captions"}
    assert [stem for stem in stems if f"{stem}: " not in text] == []
    assert f"{version_text()}: rig report {session} --figures all" in text
    assert "@misc{sliprig" in text
    assert "@article{castanoamoros2023" in text


@pytest.mark.heavy
def test_lift_for_a_paper_has_a_legend_above_its_curves(written: tuple[Path, Path]) -> None:
    trial = read_trial(written[0], read_manifest_of(written[0], TrialManifest, "no trial"))
    figure = lift_chart(trial.lifts[0], "").figure
    assert figure is not None
    height_in = figure.get_size_inches()[1]
    legend_outside(figure)
    (legend,) = figure.legends
    texts = {text.get_text() for text in legend.get_texts()}
    assert {"estimate", "markers", "\u00b12 sigma", "phase B", "slip begins", "tracking"} <= texts
    FigureCanvasAgg(figure).draw()
    above = legend.get_window_extent().y0
    assert above >= figure.axes[0].get_window_extent().y1 - 1.0
    assert figure.get_size_inches()[1] > height_in


@pytest.mark.heavy
@pytest.mark.usefixtures("quick_pages")
def test_named_figures_alone_are_written_and_an_unknown_name_is_rejected(
    written: tuple[Path, Path], tmp_path: Path
) -> None:
    done = write_report([written[0]], tmp_path / "page.html", figures="RE, lift:1")
    assert done.figures is not None
    assert {path.stem for path in done.figures.iterdir()} == {
        "simulated_Rotational_error_per_object", "simulated_wrench_lift_1", "captions",
    }  # fmt: skip
    with pytest.raises(InputError, match=r"unknown figure 'lift:9'.*choose one of all, RE, .*lift:NUMBER"):
        write_report([written[0]], tmp_path / "other.html", figures="lift:9")
    assert not (tmp_path / "other.html").exists()


def test_band_and_phase_have_clearly_different_colours() -> None:
    def lab(colour: np.ndarray) -> np.ndarray:
        return cv2.cvtColor(np.float32(colour)[None, None], cv2.COLOR_RGB2LAB)[0, 0]

    band, paper, phase = (np.array(to_rgb(of.light)) for of in (ESTIMATE, PAPER, PHASE))
    assert np.linalg.norm(lab(0.22 * band + 0.78 * paper) - lab(phase)) > 20.0


def test_special_characters_are_escaped_in_latex() -> None:
    source = latex(Table(("a_b", "50 %"), [["x&y", "{$1^2~"]]), simulated=False)
    assert r"a\_b & 50 \% \\" in source
    assert r"x\&y & \{\$1\textasciicircum{}2\textasciitilde{} \\" in source


@pytest.mark.heavy
def test_sources_without_figures_for_a_paper_are_rejected(drawn_recording: Any, tmp_path: Path) -> None:
    session = drawn_recording(tmp_path / "session")
    with pytest.raises(InputError, match="only readable trials and CSV files"):
        write_report([session], figures="all")
    assert not (session / "figures").exists()
