"""Compare figures of lifts and sessions with the limits of a bench file or of `--limits FILE`.

A limit names a figure and its lower or upper value: for each lift, for each of one object, or for
the session.
"""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from pydantic import ValidationError

from drivers.errors import InputError, unknown_name
from drivers.formats import MOST_TOML_BYTES, parse_toml, read_text
from protocols.grasps import GraspFile, find_grasp_file
from rig.config.messages import faults_of, place_of, refusal
from rig.config.models import LimitConfig, LimitsFile
from rig.results.summary import summarize_lifts
from rig.sessions.records import Lift, LiftTiming, accepted_lifts, lift_columns
from rig.sessions.table_files import unit_of

Limits = tuple[LimitConfig, ...]

OfLift = Callable[[Lift, LiftTiming | None], float | None]
"""Returns a figure of a lift; None if it was not measured, which misses a limit."""


def _apart(one: float | None, other: float | None) -> float | None:
    return None if one is None or other is None else abs(one - other)


def _frame_ms(_: Lift, timing: LiftTiming | None) -> float | None:
    total = timing.stages.get("total") if timing else None
    return total and total.p99_ms


def _largest_delay_ms(_: Lift, timing: LiftTiming | None) -> float | None:
    delays = (timing.capture_to_angle if timing else None) or {}
    return max((of.p99_ms for of in delays.values()), default=None)


def _in_column(value: Callable[[Lift], Any]) -> OfLift:
    return lambda lift, _: value(lift)


LIFT_FIGURES: Mapping[str, OfLift] = {
    **{
        column.name: _in_column(column.value)
        for column in lift_columns()
        if column.kind in (int, float) and column.name not in ("number", "attempt", "lift")
    },
    "abs_final_error_deg": lambda lift, _: _apart(lift.final_estimate_deg, lift.final_truth_deg),
    "onset_delay_s": lambda lift, _: lift.onset_delay_s,
    "dropped": lambda lift, _: sum(lift.dropped.values()),
    "contact_area_px": lambda lift, _: min(lift.contact_area_px.values(), default=None),
    "frame_p99_ms": _frame_ms,
    "capture_to_angle_p99_ms": _largest_delay_ms,
}
"""Figures of a lift by name: the numbers of `lifts.csv`, and further ones that are computed."""
SESSION_FIGURES: Mapping[str, str] = {
    "answered_in_all": "answered",
    "mare_deg": "mare_deg",
    "mare_std_deg": "mare_std_deg",
    "mare_b_deg": "mare_b_deg",
    "mare_held_deg": "mare_held_deg",
    "lifts_accepted": "lifts_accepted",
    "lifts_refused": "lifts_refused",
}
"""Figures of a session, or of one of its objects, with their keys in `TrialSummary.as_json`."""


@dataclass(frozen=True, slots=True)
class Judged:
    """A figure beside its limit. of: the lift, such as "wrench, lift 3", or "session", or its object."""

    of: str
    figure: str
    value: float | None
    asked: str
    met: bool

    @property
    def shown(self) -> str:
        """The value with its unit."""
        return "no value" if self.value is None else f"{self.value:.4g} {unit_of(self.figure) or ''}".rstrip()

    def __str__(self) -> str:
        return f"{self.of}: {self.figure} {self.shown}, required {self.asked}"


def read_limits(path: Path) -> Limits:
    """Read a file with a table [[limits]] per limit, as in a bench file. Raises `InputError`."""
    text = read_text(path, MOST_TOML_BYTES)
    document = json.dumps(parse_toml(text, str(path)), default=str)
    try:
        return LimitsFile.model_validate_json(document, strict=True).limits
    except ValidationError as error:
        raise refusal(str(path), faults_of(error, LimitsFile), text) from error


def checked_limits(
    limits: Limits,
    objects: Sequence[str],
    own: Sequence[GraspFile] = (),
    file: Path | None = None,
    all_apply: bool = True,
) -> Limits:
    """Return limits with the ids of their objects.

    objects: ids of the trial's. own: a lab's objects. file: the TOML file of the limits, for messages.
    all_apply: a limit of an object that is not lifted is an error; otherwise it is left out, because those
    of a bench file are for all trials. Raises `InputError` for an unknown figure, another unit, or another
    object.
    """
    checked = []
    for number, limit in enumerate(limits):
        where = partial(_where, file, number)
        _require_figure(limit, where)
        unit = unit_of(limit.figure)
        if limit.unit is not None and limit.unit != unit:
            own_unit = f"is in '{unit}'" if unit else "has no unit"
            raise InputError(f"{where()}: {limit.figure} {own_unit}, and the limit is in '{limit.unit}'")
        of = None if limit.object is None else find_grasp_file(limit.object, own).id
        if of is not None and of not in objects:
            if not all_apply:
                continue
            raise InputError(f"{where()}: object {limit.object} is not lifted in this trial")
        checked.append(limit.model_copy(update={"object": of}))
    return tuple(checked)


def _where(file: Path | None, number: int) -> str:
    """Return the place of a limit, with file, line and column if it is in a file."""
    name = f"limits.{number}"
    if file is None or not file.is_file():
        return name
    text = read_text(file, MOST_TOML_BYTES)
    return f"{place_of(str(file), text, ('limits', number, 'figure'))}: {name}"


def _require_figure(limit: LimitConfig, where: Callable[[], str]) -> None:
    if limit.figure not in LIFT_FIGURES and limit.figure not in SESSION_FIGURES:
        error = unknown_name("figure", limit.figure, [*LIFT_FIGURES, *SESSION_FIGURES])
        raise InputError(f"{where()}: {error}")


def apply_limits(limits: Limits, rows: Sequence[Lift], timing: Sequence[LiftTiming] = ()) -> list[Judged]:
    """Return each figure that has a limit, in the order of the limits.

    rows: attempts of a session, of which the accepted ones count. timing: of these, if known. Raises
    `InputError` for an unknown figure, as in the limits of a session that was stored by another version.
    """
    lifts = accepted_lifts(rows)
    times = {(of.number, of.attempt): of for of in timing}
    found = []
    for limit in limits:
        _require_figure(limit, lambda: "limits")
        own = [lift for lift in lifts if limit.object in (None, lift.object)]
        values: list[tuple[str, Any]]
        if limit.figure in LIFT_FIGURES:
            figure = LIFT_FIGURES[limit.figure]
            values = [(of.title, figure(of, times.get((of.number, of.attempt)))) for of in own]
        else:
            of = "session" if limit.object is None else own[0].name if own else limit.object
            values = [(of, summarize_lifts(own).as_json()[SESSION_FIGURES[limit.figure]])]
        found += [
            Judged(of, limit.figure, value, _limit_text(limit), _is_met(limit, value)) for of, value in values
        ]
    return found


def _limit_text(limit: LimitConfig) -> str:
    least = None if limit.lower is None else f"at least {limit.lower:g}"
    most = None if limit.upper is None else f"at most {limit.upper:g}"
    asked = f"{' and '.join(filter(None, (least, most)))} {unit_of(limit.figure) or ''}".rstrip()
    return asked if limit.object is None else f"{asked}, object {limit.object}"


def _is_met(limit: LimitConfig, value: float | None) -> bool:
    if value is None:
        return False
    return (limit.lower is None or value >= limit.lower) and (limit.upper is None or value <= limit.upper)


def limit_rows(found: Sequence[Judged]) -> list[tuple[str, ...]]:
    """Return a row of text per limit: figure, asked range, how many pass, and the first miss."""
    by_limit: dict[tuple[str, str], list[Judged]] = {}
    for one in found:
        by_limit.setdefault((one.figure, one.asked), []).append(one)
    rows = []
    for (figure, asked), of in by_limit.items():
        missed = [one for one in of if not one.met]
        first = f"{missed[0].of}: {missed[0].shown}" if missed else ""
        rows.append((figure, asked, f"{len(of) - len(missed)} of {len(of)}", first))
    return rows


LIMIT_HEADINGS = ("figure", "asked", "passed", "first that misses")
"""Headings of `limit_rows`."""


def json_lines(found: Sequence[Judged]) -> str:
    """Return a line of JSON per figure with a limit."""
    return "".join(json.dumps(asdict(one)) + "\n" for one in found)


_NOT_IN_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
"""Characters that XML cannot contain (XML 1.0, section 2.2); a folder's name may have them."""


def junit_xml(found: Sequence[Judged], session: str) -> str:
    """Return the figures as test cases of JUnit's XML, which CI systems show."""
    missed = sum(not one.met for one in found)
    suite = ElementTree.Element(
        "testsuite", name=session, tests=str(len(found)), failures=str(missed), errors="0", skipped="0"
    )
    for one in found:
        case = ElementTree.SubElement(suite, "testcase", classname=one.of, name=f"{one.figure} {one.asked}")
        if not one.met:
            ElementTree.SubElement(case, "failure", message=str(one))
    ElementTree.indent(suite)
    text = ElementTree.tostring(suite, encoding="unicode", xml_declaration=True) + "\n"
    return _NOT_IN_XML.sub("\ufffd", text)
