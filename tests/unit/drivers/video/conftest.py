"""MJPEG servers that are stopped after a test."""

from collections.abc import Callable, Iterator

import pytest

from support.mjpeg_servers import Behaviour, RawServer


@pytest.fixture
def serve() -> Iterator[Callable[[Behaviour], RawServer]]:
    """Start servers by what they do; they are stopped afterwards."""
    started: list[RawServer] = []

    def start(behaviour: Behaviour) -> RawServer:
        started.append(RawServer(behaviour))
        return started[-1]

    yield start
    for server in started:
        server.close()
