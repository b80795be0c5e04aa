"""Lifts with a reaction to slip beside the same lifts without, on the report of either session."""

import json
import shutil
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import InputError
from rig.report.charts import Ranges, angle_range, lift_chart, shown_range
from rig.report.parts import Chart
from rig.report.write import write_report
from rig.sessions.records import Lift

pytestmark = [pytest.mark.usefixtures("quick_pages"), pytest.mark.heavy]

REACTION = {
    "serial": "SIM-D0001", "onset_s": 0.2, "event_s": 0.21, "command_s": 0.22, "standstill_s": 0.4,
    "rest_s": 0.5, "counts_added": 6, "onset_turn_deg": 0.5, "event_turn_deg": 0.6,
    "command_turn_deg": 0.7, "standstill_turn_deg": 0.9, "rest_turn_deg": 0.9,
}  # fmt: skip


@pytest.fixture(scope="module")
def without(drawn_trial: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drawn_trial(tmp_path_factory.mktemp("beside") / "without")


@pytest.fixture(scope="module")
def reacted(without: Path) -> Path:
    """The same lifts, the first of which was caught."""
    folder = without.parent / "reacted"
    shutil.copytree(without, folder)
    edit(folder, {"react": "tighten"}, {"react": "tighten", "reactions": []})
    rows(folder, 1, outcome="caught", reactions=[REACTION], final_truth_deg=0.9)
    return folder


def edit(folder: Path, manifest: dict[str, Any], lift: dict[str, Any]) -> None:
    path = folder / "session.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | manifest))
    for number in (1, 2):
        rows(folder, number, **lift)


def rows(folder: Path, number: int, **changes: Any) -> None:
    path = folder / "lifts.jsonl"
    kept = [json.loads(line) for line in path.read_text().splitlines()]
    kept[number - 1] |= changes
    path.write_text("".join(json.dumps(row) + "\n" for row in kept))


def test_caught_lift_is_shown_beside_the_lift_without_reaction(
    without: Path, reacted: Path, tmp_path: Path
) -> None:
    for session, other in ((reacted, without), (without, reacted)):
        page = unescape(write_report([session], tmp_path / "page.html", beside=other).path.read_text())
        part = page.partition("With and without a reaction to slip</h2>")[2].partition("<h2")[0]
        assert part.count("<svg") == 2
        assert part.index("without a reaction: turned") < part.index("with 'tighten': turned +0.9")
        assert "6 grip steps added" in part
        assert part.count("wrench, lift 2") == 1  # in the table alone: it was not caught
    assert "With and without" not in write_report([reacted], tmp_path / "page.html").path.read_text()


def test_sessions_with_equal_reaction_or_other_lifts_are_rejected(
    without: Path, reacted: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    shutil.copytree(reacted, other)
    for number in (1, 2):
        rows(other, number, seed=12345)
    for session, beside, said in (
        (without, without, "neither reacts"),
        (reacted, reacted, "both react"),
        (without, other, "same --seed"),
        (tmp_path, without, "only a trial can be shown"),
    ):
        with pytest.raises(InputError, match=said):
            write_report([session], tmp_path / "page.html", beside=beside)


def test_charts_with_and_without_a_reaction_have_one_scale(
    without: Path, drawn_trial: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    drawn: list[tuple[Lift, Ranges]] = []

    def noted(lift: Lift, caption: str, ranges: Ranges | None = None) -> Chart:
        if ranges is not None:
            drawn.append((lift, ranges))
        return lift_chart(lift, caption, ranges)

    small = drawn_trial(tmp_path / "small", (1.0, -20.0))
    edit(small, {"react": "tighten"}, {"react": "tighten", "reactions": []})
    rows(small, 1, outcome="caught", reactions=[REACTION], final_truth_deg=0.9)
    monkeypatch.setattr("rig.report.trial_page.lift_chart", noted)
    write_report([small], tmp_path / "page.html", beside=without)
    (first, ranges), (second, same) = drawn
    assert np.ptp(first.truth.angle_deg) > 5.0 * np.ptp(second.truth.angle_deg)
    assert ranges == same
    assert ranges[1][0] <= angle_range(first)[0] < angle_range(first)[1] <= ranges[1][1]
    assert ranges[0] == shown_range(first)
