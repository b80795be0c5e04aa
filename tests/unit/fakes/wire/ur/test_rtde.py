"""The simulated controller's real-time data exchange, held to the frames of the RTDE guide."""

import struct

import pytest

from fakes.wire.ur.rtde import OutputBank, RtdeSession, package, split_packages

VERSION = (5, 11, 0, 108249)


class Client:
    """A session that is given its packages directly."""

    def __init__(self, refused: str | None = None) -> None:
        self.session = RtdeSession(OutputBank(), VERSION, lambda values: None, lambda _: refused)

    def ask(self, kind: str, payload: bytes = b"") -> bytes:
        [(answered, answer)] = split_packages(bytearray(self.session.feed(package(ord(kind), payload))))
        assert answered == ord(kind)
        return answer

    def outputs(self, names: str, rate_hz: float = 500.0) -> bytes:
        return self.ask("O", struct.pack(">d", rate_hz) + names.encode())


def test_first_frames_are_those_of_the_guide() -> None:
    session = Client().session
    assert session.feed(bytes.fromhex("0005560002")) == bytes.fromhex("00045601")
    assert session.feed(bytes.fromhex("000376")) == bytes.fromhex(
        "001376 00000005 0000000b 00000000 0001a6d9"
    )
    assert session.feed(bytes.fromhex("0005560001")) == bytes.fromhex("00045600"), "version 1 is refused"


@pytest.mark.parametrize(
    ("rate_hz", "cycles"),
    [(500.0, 1), (125.0, 4), (100.0, 5), (300.0, 1), (1e9, 1), (-1.0, 1), (float("nan"), 1), (5e-324, 500)],
)
def test_the_rate_is_a_whole_number_of_control_cycles(rate_hz: float, cycles: int) -> None:
    client = Client()
    client.outputs("timestamp", rate_hz)
    client.ask("S")
    assert [c for c in range(600) if client.session.due(c)] == list(range(0, 600, cycles))
