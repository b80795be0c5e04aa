"""The paper's tables on simulated lifts: thinning, networks looked at once, scores, tables and files."""

from pathlib import Path

import numpy as np
import pytest

import rig.benchmark.trials.benchmark as benchmark
from drivers.errors import InputError
from drivers.types import Frame
from rig.benchmark.trials.benchmark import (
    NETWORKS,
    TrialsResult,
    TrialsSettings,
    parse_models,
    run_trials,
    with_markers,
)
from rig.benchmark.trials.files import FIGURES, PAGE, PICTURE, write_trials
from rig.benchmark.trials.paper_tables import table_four, table_three
from rig.benchmark.trials.passes import NetworkContact, combination, thinned
from rig.benchmark.trials.systems import title
from rig.config import load_bench
from rig.sessions.files import read_json
from rig.tactile.contact.finder import NO_CONTACT, Contact
from rig.tactile.paper.axis import METHODS
from support.benches import lighter

IMAGE = np.zeros((40, 30, 3), np.uint8)


@pytest.mark.parametrize(("rate_hz", "kept"), [(60.0, 30), (30.0, 30), (25.0, 25)])
def test_faster_sensors_are_thinned_to_thirty_frames(rate_hz: float, kept: int) -> None:
    frames = [Frame(IMAGE, round(i / rate_hz * 1e9), i, "D", None) for i in range(round(rate_hz))]
    assert len(list(thinned(iter(frames)))) == kept


class Counted:
    """A segmenter that counts what it is asked."""

    asked = 0

    def find(self, image: np.ndarray) -> Contact:
        self.asked += 1
        return NO_CONTACT


def test_a_network_looks_at_each_frame_once() -> None:
    counted = Counted()
    finder = NetworkContact(counted)  # type: ignore[arg-type] - all that is asked of it is `find`
    other = IMAGE.copy()
    for image in (IMAGE, IMAGE, other, other, IMAGE):
        finder.find(image)
    assert counted.asked == 3


def test_models_are_named_files(tmp_path: Path) -> None:
    file = tmp_path / "net.onnx"
    file.touch()
    assert parse_models([f"unetplusplus={file}"]) == {"unetplusplus": file}
    for text, said in (("resnet=x", "NAME being one of"), ("pspnet", "NAME=FILE"), ("pspnet=/no", "no file")):
        with pytest.raises(InputError, match=said):
            parse_models([text])


def test_the_marked_bench_differs_in_its_gels_alone() -> None:
    bench = load_bench("fake")
    marked = with_markers(bench)
    assert all(tip.markers for tip in marked.tactile)
    assert marked.model_copy(update={"tactile": bench.tactile}) == bench


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> TrialsResult:
    """One lift at the rate that the paper's frames have, to which a faster sensor's are thinned."""
    folder = tmp_path_factory.mktemp("trials")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(benchmark, "load_bench", lighter)
        return run_trials(TrialsSettings(folder, jobs=1, lifts=1, objects=("t3",)))


def test_every_system_is_scored_on_the_same_frames(result: TrialsResult) -> None:
    assert result.missing == ("deeplabv3plus", "unetplusplus")
    assert 30 <= result.frames <= 90
    expected = {"slip", "kolamuri", "anglenet", "toskov", "still", *METHODS}
    expected |= {combination(title, m) for title in ("PSPNet", "ours") for m in METHODS}
    assert {name for name, _ in result.scores} == expected
    best = result.scores["slip", 1]
    assert best.mare is not None
    assert best.mare.mean_deg < 2.0
    assert best.answered == 1.0
    assert all(ms > 0.0 for ms in result.ms.values())
    still = result.scores["still", 1].mare
    assert still is not None
    assert still.mean_deg > 4.0 * best.mare.mean_deg


def test_the_tables_say_what_is_simulated_and_what_was_not_trained(result: TrialsResult) -> None:
    three, four = table_three(result), table_four(result)
    assert all(table.title.startswith("SIMULATED") for table in (three, four))
    assert all(len(row) == len(table.columns) for table in (three, four) for row in table.rows)
    untrained = [row for row in three.rows if "rig train --arch" in row[1]]
    assert [row[0] for row in untrained] == ["DeepLabV3+", "UNet++"]
    assert {row[0] for row in four.rows} >= {"slip", *map(title, ("kolamuri", "anglenet", "toskov"))}
    assert any("trained on these lifts (kept" in row[0] for row in four.rows)
    assert set(NETWORKS.values()) <= {row[0] for row in three.rows}


def test_the_files_are_written(result: TrialsResult, tmp_path: Path) -> None:
    write_trials(tmp_path, result)
    kept = read_json(tmp_path / FIGURES)
    assert kept["simulated"] is True
    assert len(kept["systems"]) == len(result.scores)
    page = (tmp_path / PAGE).read_text(encoding="utf-8")
    assert "SIMULATED" in page
    assert "Toskov et al." in page
    assert '<svg role="img" aria-label="Run time against error of every system"' in page
    assert "data:image/png" not in page  # the chart follows the reader's light or dark screen
    (untrained,) = [line for line in page.splitlines() if "deeplabv3plus --fold" in line]
    assert 'class="text wrap" colspan="7"' in untrained  # long words do not push the numbers away
    assert '<td class="text">2.' not in page
    assert '<a href="#part-' not in page  # three parts are seen at a glance
    assert (tmp_path / PICTURE).read_bytes().startswith(b"\x89PNG")
