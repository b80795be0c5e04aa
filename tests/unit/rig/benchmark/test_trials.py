"""The paper's tables on simulated lifts: thinning, one pass per network, scores, tables and files."""

from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drivers.errors import InputError
from drivers.types import Frame
from rig.benchmark import trials as study
from rig.benchmark.estimators.contenders import SharedContact
from rig.benchmark.harness import Report, Run
from rig.benchmark.segmentation import NETWORKS, parse_models
from rig.benchmark.trials import TITLES, TrialsOptions, measure, thin
from rig.tactile.contact.finder import NO_CONTACT
from rig.tactile.paper.axis import METHODS
from support.benches import lighter, short_phases

NETWORKS_AND_PEERS = (*NETWORKS, "toskov")
IMAGE = np.zeros((40, 30, 3), np.uint8)


@pytest.mark.parametrize(("rate_hz", "kept"), [(60.0, 30), (30.0, 30), (25.0, 25)])
def test_faster_sensors_are_thinned_to_thirty_frames(rate_hz: float, kept: int) -> None:
    frames = [Frame(IMAGE, round(i / rate_hz * 1e9), i, "D", None) for i in range(round(rate_hz))]
    assert len(list(thin(iter(frames)))) == kept


def test_network_segments_each_frame_once() -> None:
    asked: list[np.ndarray] = []
    finder = SharedContact(SimpleNamespace(find=lambda image: asked.append(image) or NO_CONTACT))
    other = IMAGE.copy()
    for image in (IMAGE, IMAGE, other, other, IMAGE):
        finder.find(image)
    assert len(asked) == 3


def test_models_are_given_as_name_and_file(tmp_path: Path) -> None:
    file = tmp_path / "net.onnx"
    file.touch()
    assert parse_models([f"unetplusplus={file}"], NETWORKS_AND_PEERS) == {"unetplusplus": file}
    wrong = {"resnet=x": "NAME being one of", "pspnet": "NAME=FILE", "pspnet=/no": "file not found"}
    for text, said in wrong.items():
        with pytest.raises(InputError, match=said):
            parse_models([text], NETWORKS_AND_PEERS)


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Report:
    """One lift with few frames."""
    folder = tmp_path_factory.mktemp("trials")
    with short_phases(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "load_bench", partial(lighter, tip_hz=10.0))
        return measure(TrialsOptions(lifts=1, objects=["t3"]), Run(jobs=1, folder=folder))


@pytest.mark.heavy
def test_every_system_is_scored_on_the_same_frames(report: Report) -> None:
    assert report.figures["not_trained"] == ("deeplabv3plus", "unetplusplus")
    assert 15 <= report.figures["frames"] <= 40
    expected = {"slip", "kolamuri", "anglenet", "toskov", "still", *METHODS}
    expected |= {f"{title} and {m}" for title in ("PSPNet", "ours") for m in METHODS}
    scores = {(score["system"], score["window"]): score for score in report.figures["systems"]}
    assert {name for name, _ in scores} == expected
    best, still = scores["slip", 1], scores["still", 1]
    assert best["mare"]["mean_deg"] < 2.0
    assert best["answered"] == 1.0
    assert all(score["ms"] > 0.0 for score in scores.values())
    assert still["mare"]["mean_deg"] > 4.0 * best["mare"]["mean_deg"]


@pytest.mark.heavy
def test_tables_mark_simulated_figures_and_networks_not_trained(report: Report) -> None:
    three, four = report.tables
    assert all(table.title.startswith("SIMULATED") for table in (three, four))
    assert all(len(row) == len(table.columns) for table in (three, four) for row in table.rows)
    untrained = [row for row in three.rows if "rig train --arch" in row[1]]
    assert [row[0] for row in untrained] == ["DeepLabV3+", "UNet++"]
    known = {"slip", *(TITLES[name] for name in ("kolamuri", "anglenet", "toskov"))}
    assert known <= {row[0] for row in four.rows}
    assert any("trained on these lifts (kept" in row[0] for row in four.rows)
    assert set(NETWORKS.values()) <= {row[0] for row in three.rows}
