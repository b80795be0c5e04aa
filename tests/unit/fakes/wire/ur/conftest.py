"""A running controller, and clients that are closed after a test."""

from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from fakes.wire.ur.controller import URController
from support.ur_clients import Client, Connect, make


@pytest.fixture
def connect() -> Iterator[Connect]:
    """Makes clients that are closed at the end."""
    with ExitStack() as stack:
        yield lambda *arguments: stack.enter_context(Client(*arguments))


@pytest.fixture
def controller() -> Iterator[URController]:
    controller = make()
    controller.start()
    yield controller
    controller.stop()
