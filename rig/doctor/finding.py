"""Print findings with their advice; percentiles of durations."""

from collections.abc import Mapping, Sequence
from textwrap import wrap

import numpy as np
from numpy.typing import ArrayLike
from rich.text import Text

from drivers.errors import plural
from rig.bench.findings import Finding
from rig.terminal.tables import table_console


def percentiles_ms(durations_s: ArrayLike) -> dict[str, float]:
    """Return median, 95th and 99th percentile and the longest of some durations, in ms."""
    values = np.asarray(durations_s, float) * 1e3
    p50, p95, p99, longest = np.percentile(values, [50, 95, 99, 100])
    return {"p50_ms": float(p50), "p95_ms": float(p95), "p99_ms": float(p99), "max_ms": float(longest)}


def percentiles_text(figures: Mapping[str, float]) -> str:
    return "p50/p95/p99/max {p50_ms:.1f}/{p95_ms:.1f}/{p99_ms:.1f}/{max_ms:.1f} ms".format(**figures)


COLOURS = {"failure": "red", "warning": "yellow", "note": "dim", "good": "green"}
"""Colour by verdict, in the order in which findings are printed."""


LEAST_ROOM = 24
"""Fewest characters for the text of a finding beside its name."""


def print_findings(findings: Sequence[Finding], verdict: str = "") -> None:
    """Print each check, failures first, then a verdict, then the advice."""
    console = table_console()
    devices, checks = (max(len(text) for text in texts) for texts in zip(*map(_name, findings), strict=True))
    order = list(COLOURS)
    for finding in sorted(findings, key=lambda each: order.index(each.verdict)):
        device, check = _name(finding)
        name = f"  {device:{devices}}  {check:{checks}}  "
        first, *more = _fold(finding.seen, console.width, len(f"{finding.verdict:7}{name}"))
        line = Text(f"{finding.verdict:7}", COLOURS[finding.verdict])
        line.append(name + first, "default")
        for rest in more:
            line.append(f"\n{rest}", "default")
        console.print(line, soft_wrap=True)
    if verdict:
        console.print(Text(verdict, "bold"))
    cures: dict[str, list[str]] = {}
    for finding in findings:
        if finding.todo:
            cures.setdefault(finding.todo, []).append(" ".join(_name(finding)))
    for todo, where in cures.items():
        console.print(f"- {', '.join(where)}: {todo}", highlight=False)


def _fold(text: str, width: int, indent: int) -> list[str]:
    """Return the lines of a text that begins at column `indent`, or below if little room is left there."""
    begin = indent if width - indent >= LEAST_ROOM else 4
    lines = wrap(text, max(width - begin, 1), break_long_words=False, break_on_hyphens=False) or [""]
    found = [lines[0], *(" " * begin + line for line in lines[1:])]
    return found if begin == indent else ["", " " * begin + lines[0], *found[1:]]


def _name(finding: Finding) -> tuple[str, str]:
    return finding.device, finding.check


def verdict_on(findings: Sequence[Finding]) -> str:
    """Return whether the bench is fit for a trial, or for its own commands, and count the problems."""
    counts = {kind: sum(each.verdict == kind for each in findings) for kind in ("failure", "warning")}
    use = "what this bench can do" if any(each.device == "bench" for each in findings) else "a trial"
    amiss = ", ".join(plural(n, kind) for kind, n in counts.items() if n)
    if counts["failure"]:
        return f"not fit for {use}: {amiss}"
    return f"fit for {use}, with {amiss}" if amiss else f"fit for {use}"
