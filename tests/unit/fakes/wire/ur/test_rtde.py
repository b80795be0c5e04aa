"""The simulated controller's real-time data exchange, held to the frames of the RTDE guide."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fakes.wire.ur.rtde import PackageType, RtdeSession, package, split_packages
from fakes.wire.ur.variables import FORMATS, OUTPUTS, OutputBank, Value

VERSION = (5, 11, 0, 108249)
RANGES = {
    "?": st.booleans(),
    "B": st.integers(0, 2**8 - 1),
    "I": st.integers(0, 2**32 - 1),
    "i": st.integers(-(2**31), 2**31 - 1),
    "Q": st.integers(0, 2**64 - 1),
    "d": st.floats(allow_nan=False, width=64),
}


class Client:
    """A session and what it wrote, driven by hand."""

    def __init__(self, refused: str | None = None) -> None:
        self.bank = OutputBank()
        self.written: list[dict[str, Value]] = []
        self.session = RtdeSession(self.bank, VERSION, self.written.append, lambda _: refused)

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


def test_input_recipes_are_numbered_from_one_and_write_their_values() -> None:
    client = Client()
    assert client.ask("I", b"input_int_register_0,input_double_register_3,") == b"\x01INT32,DOUBLE"
    assert client.ask("I", b"no_such_input") == b"\x00NOT_FOUND"
    assert client.ask("I", b"standard_digital_output") == b"\x02UINT8"
    client.session.feed(package(PackageType.DATA, b"\x01" + struct.pack(">id", -7, 2.5)))
    client.session.feed(package(PackageType.DATA, b"\x02\x80"))
    assert client.written == [
        {"input_int_register_0": -7, "input_double_register_3": 2.5},
        {"standard_digital_output": 0x80},
    ]


@given(st.sampled_from(sorted(OUTPUTS.items())), st.data())
def test_every_output_is_packed_by_its_type(variable: tuple[str, str], data: st.DataObject) -> None:
    name, kind = variable
    code = FORMATS[kind]
    count = int(code[:-1] or 1)
    values = tuple(data.draw(RANGES[code[-1]]) for _ in range(count))
    bank = OutputBank()
    bank.set(name, values if count > 1 else values[0])
    assert struct.unpack(f">{code}", bank.packed([name])) == values


@given(st.lists(st.tuples(st.integers(0, 255), st.binary(max_size=50)), max_size=8), st.integers(1, 40))
def test_packages_are_reassembled_from_any_chunks(packages: list[tuple[int, bytes]], step: int) -> None:
    stream = b"".join(package(kind, payload) for kind, payload in packages)
    buffer, seen = bytearray(), []
    for start in range(0, len(stream), step):
        buffer += stream[start : start + step]
        seen += split_packages(buffer)
    assert seen == packages
    assert not buffer
