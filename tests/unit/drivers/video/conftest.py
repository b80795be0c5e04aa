"""MJPEG servers that are stopped after a test."""

from collections.abc import Callable, Iterator

import pytest

from support.mjpeg_servers import Behaviour, RawServer


@pytest.fixture
def serve() -> Iterator[Callable[[Behaviour], RawServer]]:
    """Start servers with given handlers; they are stopped after the test."""
    started: list[RawServer] = []

    def start(behaviour: Behaviour) -> RawServer:
        started.append(RawServer(behaviour))
        return started[-1]

    yield start
    for server in started:
        server.close()
