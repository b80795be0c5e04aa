"""The simulated controller's real-time data exchange, held to the frames of the RTDE guide."""

import struct

import pytest

from fakes.wire.ur.rtde import OutputBank, RtdeSession, package


@pytest.fixture
def session() -> RtdeSession:
    return RtdeSession(OutputBank(), (5, 11, 0, 108249), lambda values: None)


def test_first_frames_are_those_of_the_guide(session: RtdeSession) -> None:
    assert session.feed(bytes.fromhex("0005560002")) == bytes.fromhex("00045601")
    assert session.feed(bytes.fromhex("000376")) == bytes.fromhex(
        "001376 00000005 0000000b 00000000 0001a6d9"
    )
    assert session.feed(bytes.fromhex("0005560001")) == bytes.fromhex("00045600"), "version 1 is refused"


@pytest.mark.parametrize(
    ("rate_hz", "cycles"),
    [(500.0, 1), (125.0, 4), (100.0, 5), (300.0, 1), (1e9, 1), (-1.0, 1), (float("nan"), 1), (5e-324, 500)],
)
def test_the_rate_is_a_whole_number_of_control_cycles(
    session: RtdeSession, rate_hz: float, cycles: int
) -> None:
    asked = package(ord("O"), struct.pack(">d", rate_hz) + b"timestamp") + package(ord("S"))
    assert session.feed(asked) == package(ord("O"), b"\x01DOUBLE") + package(ord("S"), b"\x01")
    assert [c for c in range(600) if session.due(c)] == list(range(0, 600, cycles))
