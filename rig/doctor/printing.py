"""The findings of `rig doctor` on the terminal."""

from collections.abc import Sequence

from rich.text import Text

from rig.doctor.finding import Finding
from rig.live.tables import table_console

COLOURS = {"failure": "red", "warning": "yellow", "note": "dim", "good": "green"}
"""Colour by verdict, in the order in which findings are printed."""


def print_findings(bench: str, findings: Sequence[Finding]) -> None:
    """Print one line per check, failures first, then the verdict, then the advice."""
    console = table_console()
    devices, checks = (max(len(text) for text in texts) for texts in zip(*map(_name, findings), strict=True))
    order = list(COLOURS)
    for finding in sorted(findings, key=lambda each: order.index(each.verdict)):
        device, check = _name(finding)
        line = Text(f"{finding.verdict:7}", COLOURS[finding.verdict])
        line.append(f"  {device:{devices}}  {check:{checks}}  {finding.seen}", "default")
        line.truncate(console.width, overflow="ellipsis")
        console.print(line, no_wrap=True)
    console.print(Text(f"{bench}: {_verdict(findings)}", "bold"))
    cures: dict[str, list[str]] = {}
    for finding in findings:
        if finding.todo:
            whole = f"{finding.seen}; " if finding.verdict == "failure" else ""  # its line may be cut
            cures.setdefault(whole + finding.todo, []).append(" ".join(_name(finding)))
    for todo, where in cures.items():
        console.print(f"- {', '.join(where)}: {todo}", highlight=False)


def _name(finding: Finding) -> tuple[str, str]:
    return finding.device, finding.check


def _verdict(findings: Sequence[Finding]) -> str:
    """Return whether the bench is fit for a trial, or for its own commands, and count the problems."""
    counts = {kind: sum(each.verdict == kind for each in findings) for kind in ("failure", "warning")}
    use = "what this bench can do" if any(each.device == "bench" for each in findings) else "a trial"
    amiss = ", ".join(f"{n} {kind}{'s' if n > 1 else ''}" for kind, n in counts.items() if n)
    if counts["failure"]:
        return f"not fit for {use}: {amiss}"
    return f"fit for {use}, with {amiss}" if amiss else f"fit for {use}"
