"""The page of file formats names the keys, columns, outcomes and topics that the code writes."""

import re
from dataclasses import fields

import rig.sessions.about
import rig.sessions.recorder
from rig.results.table import ERRORS
from rig.sessions.records import IF_REACTING, IN_CSV, Lift, LiftOutcome, lift_columns
from support.documentation import ROOT

PAGE = (ROOT / "docs" / "formats.md").read_text(encoding="utf-8")


def section(heading: str) -> str:
    """The text below a heading, to the next one."""
    return re.split(r"^#+ ", PAGE.split(f"### {heading}\n")[1], flags=re.MULTILINE)[0]


def first_cells(text: str) -> set[str]:
    """What stands between backticks in the first column of the tables of a text."""
    return {
        name
        for row in re.findall(r"^\|([^|]*)\|", text, re.MULTILINE)
        for name in re.findall("`([^`]+)`", row)
    }


KEYS, RECORDING = section("The keys of a lift"), section("The recording of a lift")
BOTH_TABLES = first_cells(KEYS)


def test_keys_and_outcomes_of_a_lift_are_named() -> None:
    keys = {field.name for field in fields(Lift) if "doc" in field.metadata}
    assert keys | {outcome.value for outcome in LiftOutcome} == BOTH_TABLES


def test_columns_of_the_table_of_lifts_are_named() -> None:
    after = " ".join(KEYS.split("`lifts.csv` has")[1].split())
    columns = {column.name for column in lift_columns() if column.tables in (IN_CSV, IF_REACTING)}
    errors = {name for name in columns if name.startswith("re_") and not name.startswith("re_b_")}
    assert columns - errors <= set(re.findall("`([^`]+)`", after))


def test_errors_of_the_table_of_lifts_are_keys() -> None:
    assert set(ERRORS) <= BOTH_TABLES


def test_topics_of_a_recording_are_named() -> None:
    topics = {
        value + ("SERIAL" if name.endswith("_PREFIX") else "")
        for module in (rig.sessions.recorder, rig.sessions.about)
        for name, value in vars(module).items()
        if name.endswith(("_TOPIC", "_PREFIX"))
    }
    assert len(topics) >= 12
    assert topics == first_cells(RECORDING)
