"""The driver with pymodbus's simulator as the gripper: slow, and strict about the unit id."""

import asyncio
import threading
import time
from collections.abc import Iterator

import pytest
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from drivers.errors import DeviceError
from drivers.robotiq_3f.gripper import Robotiq3F, tcp_link
from support.connected import connected
from support.finger_counts import counts_of, opening_m

REFRESH_S = 0.06
COUNTS_PER_S = 300.0


class SlowGripper:
    """A gripper that reports each command a dozen refreshes later; bytes as in the manual's tables."""

    def __init__(self) -> None:
        self.writes: list[tuple[float, bytes]] = [(0.0, bytes(16))]
        self.positions = {3: 7.0, 6: 6.0, 9: 6.0}
        self.last = time.monotonic()

    async def serve(
        self,
        function: int,
        start: int,
        address: int,
        count: int,
        registers: list[int],
        values: list[int] | None,
    ) -> ExcCodes | None:
        """Process a written register image, or put the status into the registers that are read."""
        if values is not None:
            data = b"".join(value.to_bytes(2, "big") for value in values)
            self.writes.append((time.monotonic(), data.ljust(16, b"\0")))
        elif function == 4:
            image = self.image()
            registers[:8] = [image[at] << 8 | image[at + 1] for at in range(0, 16, 2)]
        return None

    def image(self) -> bytes:
        now = time.monotonic()
        command = (
            [data for at, data in self.writes if at < now - REFRESH_S][-1] if now > REFRESH_S else bytes(16)
        )
        travel, self.last = COUNTS_PER_S * (now - self.last), now
        active, going = command[0] & 1, bool(command[0] & 8)
        image, moving = bytearray(16), False
        for offset in self.positions:
            asked = command[offset if command[1] & 4 else 3]
            if going:
                away = asked - self.positions[offset]
                self.positions[offset] += max(-travel, min(travel, away))
                moving |= self.positions[offset] != asked
            image[offset], image[offset + 1] = command[offset], round(self.positions[offset])
        image[0] = command[0] & 15 | (0x30 if active else 0) | (0xC0 if going and not moving else 0)
        return bytes(image)


@pytest.fixture
def foreign() -> Iterator[tuple[SlowGripper, int]]:
    """The gripper, and the port of its server."""
    gripper, ready, loop = SlowGripper(), threading.Event(), asyncio.new_event_loop()
    ports: list[int] = []

    async def run() -> None:
        block = [SimData(0, count=8, values=0, datatype=DataType.REGISTERS)]
        bits = [SimData(0, count=8, values=False, datatype=DataType.BITS)]
        device = SimDevice(2, simdata=(bits, bits, block, block), action=gripper.serve)
        server = ModbusTcpServer(device, address=("127.0.0.1", 0))
        await server.serve_forever(background=True)
        ports.append(server.transport.sockets[0].getsockname()[1])  # type: ignore[union-attr]
        ready.set()
        await stop.wait()
        await server.shutdown()

    stop = asyncio.Event()
    thread = threading.Thread(target=lambda: loop.run_until_complete(run()))
    thread.start()
    assert ready.wait(5.0)
    yield gripper, ports[0]
    loop.call_soon_threadsafe(stop.set)
    thread.join(5.0)
    loop.close()


def test_stale_status_of_a_slow_gripper_does_not_end_a_motion(foreign: tuple[SlowGripper, int]) -> None:
    simulated, port = foreign
    with connected(Robotiq3F(tcp_link("127.0.0.1", port))) as gripper:
        assert len(simulated.writes) == 1, "connecting writes nothing"
        gripper.activate()
        for counts in (100, 101, 102, 20, 20, 60):
            gripper.move_to(opening_m(gripper, counts)).wait(5.0)
            assert (simulated.positions[6], simulated.positions[9]) == (counts, counts)
            assert counts_of(gripper) == counts
        assert simulated.positions[3] == 7.0, "the parked finger keeps its own position"
        gripper.move_to(opening_m(gripper, 250))
        while counts_of(gripper) < 70:
            time.sleep(0.005)
        gripper.stop()
        held = simulated.positions[6]
        time.sleep(0.1)
        assert simulated.positions[6] == held < 250


def test_disconnecting_stops_a_motion_not_yet_in_the_status(foreign: tuple[SlowGripper, int]) -> None:
    simulated, port = foreign
    with connected(Robotiq3F(tcp_link("127.0.0.1", port))) as gripper:
        gripper.activate()
        gripper.move_to(opening_m(gripper, 250))
    assert not simulated.writes[-1][1][0] & 8, "the last word is not to go on"
    with connected(gripper):
        time.sleep(3 * REFRESH_S)
        assert not gripper.state().moving
        assert counts_of(gripper) < 100


def test_gripper_with_another_register_map_is_rejected_with_advice(foreign: tuple[SlowGripper, int]) -> None:
    gripper = Robotiq3F(tcp_link("127.0.0.1", foreign[1], preset="tcp-2014"))
    with pytest.raises(DeviceError, match="exception 2; check preset"):
        gripper.connect()
