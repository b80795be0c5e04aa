"""What `rig doctor` prints at 80 columns, and what `rig fakes serve --write` ends with."""

import pytest

from rig.bench.findings import Finding, Severity
from rig.terminal.tables import PlainConsole
from support.command_line import rig

RATE = "36.15 of 60 a second, 2 missed; p50/p95/p99/max 16.8/46.5/49.1/49.8 ms apart"
USB = "give each camera its own USB controller (a hub does not help), or request a lower rate"
FINDINGS = (
    Finding("computer", "software", Severity.GOOD, "Python 3.11.7, 2 cores"),
    Finding("gripper", "state", Severity.NOTE, "not activated"),
    Finding("SIM-D0001", "frames", Severity.WARNING, RATE, USB),
    Finding("SIM-D0002", "frames", Severity.WARNING, RATE, USB),
    Finding("arm", "reached", Severity.FAILURE, f"no answer {'x' * 70}", "check power, cable and address"),
)


def doctor(monkeypatch: pytest.MonkeyPatch, *findings: Finding, width: int = 80) -> list[str]:
    monkeypatch.setattr("rig.doctor.examination.examine", lambda *_: iter(findings))
    monkeypatch.setattr("rig.doctor.finding.table_console", lambda: PlainConsole(width=width))
    done = rig("doctor")
    assert done.returncode == any(each.verdict == "failure" for each in findings)
    return done.stdout.splitlines()


@pytest.mark.parametrize("width", [80, 60, 40])
def test_doctor_prints_every_check_in_full_then_the_verdict_then_the_cures(
    monkeypatch: pytest.MonkeyPatch, width: int
) -> None:
    lines = doctor(monkeypatch, *FINDINGS, width=width)
    assert all(len(line) <= width for line in lines if "xxx" not in line)
    heads = [line.split()[0] for line in lines if line[:1].strip() and line.split()[0] in (*Severity,)]
    assert heads == ["failure", "warning", "warning", "note", "good"]
    text = " ".join(" ".join(lines).split())
    assert "\N{HORIZONTAL ELLIPSIS}" not in text
    assert text.count(RATE) == 2
    assert f"no answer {'x' * 70} " in text
    assert "SIMULATED bench 'fake': not fit for a trial: 1 failure, 2 warnings" in text
    assert f"- SIM-D0001 frames, SIM-D0002 frames: {USB}" in text
    assert "- arm reached: check power, cable and address" in text


@pytest.mark.parametrize(
    ("findings", "verdict"),
    [(FINDINGS[:2], "fit for a trial"), (FINDINGS[:3], "fit for a trial, with 1 warning")],
)
def test_doctor_verdict_without_failures(
    monkeypatch: pytest.MonkeyPatch, findings: tuple[Finding, ...], verdict: str
) -> None:
    lines = doctor(monkeypatch, *findings)
    assert f"SIMULATED bench 'fake': {verdict}" in lines
