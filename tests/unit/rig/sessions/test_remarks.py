"""Names, notes and tags of a session are stored beside the request, and are not part of it."""

from dataclasses import replace
from pathlib import Path

import pytest

from drivers.errors import InputError
from rig.config import load_bench
from rig.experiments.lift_plan import TrialSettings
from rig.experiments.trial import trial_manifest
from rig.report.parts import header
from rig.sessions.about import NO_REMARKS, Remarks, remarks_of
from rig.sessions.codec import json_value
from rig.sessions.manifest import TrialManifest, first_difference, read_manifest_of
from rig.sessions.records import LIFTS
from rig.sessions.session import open_session
from rig.tactile.estimators import choose_estimator


def manifest(remarks: Remarks = NO_REMARKS) -> TrialManifest:
    return trial_manifest(TrialSettings(load_bench("fake"), 0, choose_estimator()), ["t1"], 1, remarks)


def stored(folder: Path) -> TrialManifest:
    return read_manifest_of(folder, TrialManifest, "")


def test_remarks_are_stored_and_not_part_of_the_request(tmp_path: Path) -> None:
    said = remarks_of("new gel", "cleaned <twice> & dried", ["gel-7", "gel-7", "übung"], "Ada")
    open_session(tmp_path / "s", manifest(said), LIFTS, resume=False).close()
    kept = stored(tmp_path / "s")
    assert kept.remarks == Remarks("new gel", "cleaned <twice> & dried", ("gel-7", "übung"), "Ada")
    assert first_difference(kept, manifest()) is None
    assert header(kept, "Slip trial")["what"] == "new gel: Slip trial"
    assert "tags: gel-7, übung · operator: Ada" in header(kept, "Slip trial")["remarks"]


def test_feeder_may_be_added_to_the_bench_file_of_a_session() -> None:
    """A feeder places objects but changes no result."""
    plain = manifest()
    table = plain.config.table.model_copy(update={"feeder": "magazine"})
    fed = replace(plain, config=plain.config.model_copy(update={"table": table}))
    assert first_difference(plain, fed) is None
    assert first_difference(fed, plain) is None
    moved = table.model_copy(update={"position_m": (0.0, 0.1, 0.2)})
    other = replace(plain, config=plain.config.model_copy(update={"table": moved}))
    assert str(first_difference(plain, other)).startswith("config.table.position_m")


def test_session_without_remarks_has_no_extra_keys() -> None:
    assert "remarks" not in json_value(manifest())


def test_remarks_given_on_resume_are_added(tmp_path: Path) -> None:
    folder = tmp_path / "s"
    open_session(folder, manifest(remarks_of("first", None, ["a"], "Ada")), LIFTS, resume=False).close()
    open_session(folder, manifest(), LIFTS, resume=True).close()
    assert stored(folder).remarks == Remarks("first", "", ("a",), "Ada")
    open_session(folder, manifest(remarks_of("second", "late", ["b", "a"], None)), LIFTS, resume=True).close()
    assert stored(folder).remarks == Remarks("second", "late", ("a", "b"), "Ada")


@pytest.mark.parametrize(
    ("name", "note", "tags", "said"),
    [
        ("a\nb", None, [], "--name: give one line"),
        ("", None, [], "--name"),
        ("x" * 81, None, [], "at most 80"),
        (None, "\x1b[31m", [], "--note"),
        (None, None, ["two words"], "--tag 'two words': a tag is one word"),
        (None, None, ["-a"], "--tag"),
        (None, None, [f"t{i}" for i in range(21)], "21 tags"),
    ],
)
def test_remarks_that_cannot_be_shown_are_rejected(
    name: str | None, note: str | None, tags: list[str], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        remarks_of(name, note, tags, None)
