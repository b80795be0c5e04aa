"""A terminal to run commands at."""

from collections.abc import Callable, Iterator

import pytest

from support.terminal import Terminal


@pytest.fixture
def at_terminal() -> Iterator[Callable[[list[str], int], Terminal]]:
    """Return a function that runs a command at a terminal: `at_terminal(command, columns)`."""
    running: list[Terminal] = []

    def run(command: list[str], columns: int) -> Terminal:
        running.append(Terminal(command, columns))
        return running[-1]

    yield run
    for terminal in running:
        terminal.close()
