"""A bench file with placeholders is refused by every command before any device is reached."""

import socket
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from support.benches import real_bench
from support.command_line import rig

HERE = "127.0.0.78"
ARM_PORTS = (29999, 30004)
PAYLOAD = "payload_kg = 2.5"
COMMANDS = [
    ["doctor"],
    ["trial", "--lifts", "1", "--object", "t1", "--yes", "--out", "out"],
    ["trial", "--lifts", "1", "--object", "t1", "--dry-run"],
    ["record", "--object", "7", "--yes", "--out", "out"],
    ["record", "--object", "7", "--by", "hand", "--out", "out"],
    ["teach", "out.toml"],
    ["calibrate", "tcp"],
    ["calibrate", "gripper"],
    ["calibrate", "markers"],
    ["calibrate", "tactile"],
    ["calibrate", "sync"],
    ["objects"],
]


@pytest.fixture
def listeners() -> Iterator[list[socket.socket]]:
    """Sockets on this computer that wait for the arm's and the gripper's client."""
    with ExitStack() as stack:
        made = [stack.enter_context(socket.create_server((HERE, port))) for port in (*ARM_PORTS, 0)]
        for listener in made:
            listener.setblocking(False)
        yield made


def bench_file(folder: Path, listeners: list[socket.socket]) -> Path:
    """Write a bench whose arm and gripper are at the listeners."""
    text = real_bench().replace("192.0.2.10", HERE).replace("192.0.2.11", HERE)
    path = folder / "bench.toml"
    path.write_text(text.replace("port = 502", f"port = {listeners[-1].getsockname()[1]}"))
    return path


def connections(listeners: list[socket.socket]) -> int:
    count = 0
    for listener in listeners:
        try:
            while True:
                listener.accept()[0].close()
                count += 1
        except BlockingIOError:
            continue
    return count


def test_bench_file_with_a_placeholder_connects_to_nothing(
    tmp_path: Path, listeners: list[socket.socket], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = bench_file(tmp_path, listeners)
    complete = path.read_text()
    assert PAYLOAD in complete
    path.write_text(complete.replace(PAYLOAD, 'payload_kg = "ENTER the weighed mass in kg"'))
    monkeypatch.chdir(tmp_path)
    for command in COMMANDS:
        done = rig(*command, "--bench", str(path))
        assert done.returncode == 2, (command, done.stderr)
        assert "arm.payload_kg: enter the weighed mass in kg" in done.stderr, (command, done.stderr)
        assert connections(listeners) == 0, command
    assert not (tmp_path / "out").exists()


def test_filled_bench_file_reaches_the_arm_and_the_gripper(
    tmp_path: Path, listeners: list[socket.socket]
) -> None:
    done = rig("doctor", "--bench", str(bench_file(tmp_path, listeners)), "--seconds", "0.5")
    assert connections(listeners) > 0, done.stderr + done.stdout
