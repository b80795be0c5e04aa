"""Shared memory that one process writes and another reads, without locks."""

import subprocess
import sys

from drivers.ur5e.shared_state import SharedState

READING = """
import sys
from drivers.ur5e.shared_state import SharedState
state = SharedState(int(sys.argv[1]))
least = state.polled_ns()
print(flush=True)
for _ in range(400_000):
    least = min(least, state.polled_ns())
print(least)
"""


def test_poll_time_is_never_read_half_written() -> None:
    """A poll time that was read as 0 stopped an arm although its program polled."""
    state = SharedState()
    state.note_poll(1000)
    command = [sys.executable, "-c", READING, str(state.fd)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, pass_fds=(state.fd,)) as reader:
        assert reader.stdout is not None
        reader.stdout.readline()
        while reader.poll() is None:
            for time_ns in range(1000, 2000):
                state.note_poll(time_ns)
        assert int(reader.stdout.read()) >= 1000
    state.close()
