"""The doctor's checks of the arm and the gripper: connection, state, timing. Nothing moves."""

import math

import numpy as np

from drivers.bench import Bench
from drivers.clock import NS_PER_S, Clock, to_ns
from drivers.errors import RigError
from drivers.interfaces import Arm, Gripper
from drivers.types import ArmMode
from rig.bench.findings import Finding, Severity, assess, reach, read_gripper, read_slider
from rig.config import ArmConfig
from rig.doctor.finding import percentiles_ms, percentiles_text

POLL_S = 0.0005
"""Interval at which the arm's state is polled: shorter than the 2 ms between states."""
RATE_SHARE = 0.98
"""Lowest accepted fraction of the requested state rate: 490 of 500 samples per second."""
SLOW_REQUEST_MS = 20.0
"""Highest accepted 99th percentile of gripper requests. One takes a few ms; a lift has dozens of steps with
several requests each."""
DRIFT_PPM = 200.0
"""Highest accepted drift between the controller's clock and this computer's."""


def look_at_arm(bench: Bench, config: ArmConfig, duration_s: float) -> list[Finding]:
    """Connect, identify, and measure the state stream for a while; the arm stays connected."""
    findings: list[Finding] = []
    state = reach("arm", bench.arm, bench.arm.state, bench.clock, findings)
    if state is None:
        return findings
    findings.append(read_slider(bench.arm))
    findings.append(_mode(state.mode))
    if not config.force_sensor:
        todo = "keep a hand on the emergency stop: the way down is not guarded"
        findings.append(Finding("arm", "force sensor", Severity.WARNING, "none", todo))
    try:
        if config.driver == "ur5e":
            findings += _stream(bench.arm, bench.clock, config.frequency_hz, duration_s)
    except RigError as error:
        findings.append(Finding("arm", "state stream", Severity.FAILURE, str(error)))
    return findings


def look_at_gripper(bench: Bench, duration_s: float) -> list[Finding]:
    """Connect, identify, and time requests for a while; the gripper is not activated."""
    findings: list[Finding] = []
    if not read_gripper(bench.gripper, bench.clock, findings):
        return findings
    try:
        return findings + _requests(bench.gripper, bench.clock, duration_s)
    except RigError as error:
        return [*findings, Finding("gripper", "requests", Severity.FAILURE, str(error))]


def _mode(mode: ArmMode) -> Finding:
    todo = {
        ArmMode.RUNNING: "",
        ArmMode.PROTECTIVE_STOP: "look at the arm, clear the cause; the next trial asks before releasing it",
        ArmMode.EMERGENCY_STOP: "clear the cause, unlock the emergency stop, restart the arm on the pendant",
        ArmMode.UNKNOWN: "power the arm on and release its brakes on the pendant",
    }[mode]
    return assess("arm", "mode", not todo, mode.value, todo, otherwise=Severity.FAILURE)


def _stream(arm: Arm, clock: Clock, wanted_hz: float, duration_s: float) -> list[Finding]:
    before_s = arm.clock_offset_s()
    times = _distinct_times(arm, clock, duration_s)
    gaps = np.diff(times) / NS_PER_S
    rate_hz = len(gaps) / float(gaps.sum()) if len(gaps) else 0.0
    figures = {"rate_hz": rate_hz, "wanted_hz": wanted_hz}
    if len(gaps) == 0:
        return [
            Finding("arm", "state stream", Severity.FAILURE, "no new state", "see rig doctor's log", figures)
        ]
    interval = percentiles_ms(gaps)
    good = rate_hz >= RATE_SHARE * wanted_hz
    seen = f"{rate_hz:.1f} of {wanted_hz:g} a second; {percentiles_text(interval)} apart"
    todo = "use a wired network without a switch in between; end other loads here"
    stream = assess("arm", "state stream", good, seen, todo, {**figures, **interval})
    return [stream, *_clock(before_s, arm.clock_offset_s(), duration_s)]


def _distinct_times(arm: Arm, clock: Clock, duration_s: float) -> list[int]:
    times: list[int] = []
    end = clock.now_ns() + to_ns(duration_s)
    while clock.now_ns() < end:
        time_ns = arm.state().time_ns
        if not times or time_ns != times[-1]:
            times.append(time_ns)
        clock.sleep_until(clock.now_ns() + to_ns(POLL_S))
    return times


def _clock(before_s: float | None, after_s: float | None, duration_s: float) -> list[Finding]:
    if before_s is None or after_s is None or not math.isfinite(after_s):
        return []
    drift = (after_s - before_s) / duration_s * 1e6
    seen = f"controller's time is {after_s:+.4f} s from ours, drifts by {drift:+.0f} us/s"
    good = abs(drift) <= DRIFT_PPM
    todo = "nothing when the stream is slow too; otherwise measure for longer with --seconds"
    return [assess("arm", "clock", good, seen, todo, {"offset_s": after_s, "drift_ppm": drift})]


def _requests(gripper: Gripper, clock: Clock, duration_s: float) -> list[Finding]:
    """Evaluate the request times that the driver reports while the state is read."""
    if not gripper.round_trips_s():
        return []
    end = clock.now_ns() + to_ns(duration_s)
    while clock.now_ns() < end:
        gripper.state()
        clock.sleep_until(clock.now_ns() + to_ns(0.002))
    taken = gripper.round_trips_s()
    figures = percentiles_ms(taken)
    good = figures["p99_ms"] <= SLOW_REQUEST_MS
    seen = f"{len(taken)} requests, {percentiles_text(figures)}"
    todo = "check cable and termination, take other masters off the bus"
    return [assess("gripper", "Modbus requests", good, seen, todo, {"requests": len(taken), **figures})]
