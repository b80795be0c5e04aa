"""`rig benchmark contact`: spans of frames that hold something or nothing, and what is told of them."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.errors import InputError
from rig.benchmark.contact.benchmark import ContactCounts, run_contact
from rig.benchmark.contact.spans import COLUMNS, FrameSpan, read_spans
from rig.tactile.estimators import choose_estimator
from support.command_line import rig

Draw = Callable[..., NDArray[np.uint8]]
HEADER = ",".join(COLUMNS)


@pytest.fixture(scope="module")
def clips(press: Draw, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One recording: frames 0 to 5 and 12 to 19 empty, 6 to 11 in contact."""
    folder = tmp_path_factory.mktemp("contact")
    (folder / "one").mkdir()
    for i in range(20):
        image = press(15.0 if 6 <= i < 12 else None, (85, 25), seed=i)
        cv2.imwrite(str(folder / "one" / f"{i:02d}.png"), image[..., ::-1])
    return folder


def table(folder: Path, *rows: str) -> Path:
    file = folder / "spans.csv"
    file.write_text("\n".join([HEADER, *rows]) + "\n")
    return file


def test_the_table_that_comes_with_it_is_sound() -> None:
    found = read_spans()
    assert len(found) == 12
    assert sum(span.last - span.first + 1 for clip in found for span in clip.empty) == 2690
    assert sum(span.last - span.first + 1 for clip in found for span in clip.held) == 354
    assert all(clip.background.clip != clip.clip for clip in found), (
        "dots do not come to rest where they were"
    )


def test_what_is_told_is_counted(clips: Path, tmp_path: Path) -> None:
    spans = read_spans(table(tmp_path, "one,3,5,no,one,0,2", "one,14,19,no,one,0,2", "one,7,10,yes,one,0,2"))
    assert spans[0].background == FrameSpan("one", 0, 2)
    result = run_contact(clips, spans, [choose_estimator("slip")])
    assert result.overall("slip").empty == ContactCounts(9, 0)
    assert result.overall("slip").held == ContactCounts(4, 4)
    assert all(limit.met for limit in result.limits)


def test_a_missed_limit_is_exit_code_4(clips: Path, tmp_path: Path) -> None:
    wrong = table(tmp_path, "one,6,11,no,one,0,2", "one,14,19,yes,one,0,2")
    done = rig("benchmark", "contact", clips, "--spans", wrong, "--json")
    assert done.returncode == 4
    figures = json.loads(done.stdout)
    assert figures["estimators"]["slip"]["all"]["empty"] == {"frames": 6, "told": 6}
    assert [limit["met"] for limit in figures["limits"]] == [False, False]
    lenient = rig("benchmark", "contact", clips, "--spans", wrong, "--empty", 1, "--held", 0, "--json")
    assert lenient.returncode == 0


def test_a_span_without_frames_of_a_kind_misses_its_limit(clips: Path, tmp_path: Path) -> None:
    result = run_contact(clips, read_spans(table(tmp_path, "one,3,5,no,one,0,2")), [choose_estimator("pca")])
    assert [limit.met for limit in result.limits] == [True, False]


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        ((), "line 2 is missing"),
        (("one,3,5,maybe,one,0,2",), "line 2: contact 'maybe': give yes or no"),
        (("one,5,3,no,one,0,2",), "line 2: frames '5' to '3'"),
        (("one,-1,3,no,one,0,2",), "line 2: frames '-1' to '3'"),
        (("one,1,3,no,one,0,2", "one,5,6,yes,one,1,2"), "line 3: 'one' has another background above"),
    ],
)
def test_a_wrong_table_names_its_line(tmp_path: Path, rows: tuple[str, ...], why: str) -> None:
    with pytest.raises(InputError, match=why):
        read_spans(table(tmp_path, *rows))


@pytest.mark.parametrize(
    ("row", "why"),
    [
        ("one,3,99,no,one,0,2", "frame 99 is named, the clip has 20"),
        ("one,3,5,no,one,50,52", "has no frames 50 to 52"),
        ("two,3,5,no,one,0,2", "no such file or folder"),
    ],
)
def test_frames_that_are_not_there_are_named(clips: Path, tmp_path: Path, row: str, why: str) -> None:
    with pytest.raises(InputError, match=why):
        run_contact(clips, read_spans(table(tmp_path, row)), [choose_estimator("pca")])


def test_real_dotted_gels_keep_the_limits(real_data: Path) -> None:
    result = run_contact(real_data / "marker_slip_clips", read_spans(), [choose_estimator("slip")])
    assert [limit.met for limit in result.limits] == [True, True], result.limits
