"""Messages from a lift to viewers, sent without blocking; undeliverable messages are dropped.

A message is one datagram on a local socket (unix(7), SOCK_DGRAM). If a viewer is slow, stopped or gone, the
message is lost and the lift goes on. Worker processes send in the same way as the main process. The receiver
keeps the newest messages and drops the oldest.
"""

import json
import os
import socket
import tempfile
import threading
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from typing import Any

OBJECT = "object"
"""Name under which the angle of the object, from two sensors on a desk, is shown beside the sensors."""
NO_FRAMES = "no frames"
"""State of a sensor from which no frames arrive, as if its cable is unplugged."""
REFERENCE, TAKE_BACKGROUND, RECORD, SAVE = "reference", "background", "record", "save"
ESTIMATOR, MARK = "estimator", "mark"
"""Actions of the page of `rig live`, which its desk carries out; `estimator` is followed by a name, `mark` by
a capture time in s."""
KEPT_MESSAGES = 512
"""Unread messages that a receiver keeps: some seconds of one lift."""
LARGEST_BYTES = 200_000
"""A datagram has to fit into a socket's send buffer, 208 KiB by default (socket(7), wmem_default)."""


@dataclass(frozen=True, slots=True)
class Message:
    """An event: its kind, JSON values, and optionally a JPEG."""

    kind: str
    values: dict[str, Any]
    picture: bytes = b""

    def pack(self) -> bytes:
        """Return the datagram: a line of JSON, then the image's bytes."""
        return json.dumps({"kind": self.kind, **self.values}).encode() + b"\n" + self.picture

    @classmethod
    def unpack(cls, data: bytes) -> "Message":
        """Return the message in a datagram. Raises `ValueError` for an invalid one."""
        line, _, picture = data.partition(b"\n")
        values = json.loads(line)
        if not isinstance(values, dict) or "kind" not in values:
            raise ValueError("not a message of the live view")
        return cls(values.pop("kind"), values, picture)


@dataclass(frozen=True, slots=True)
class Listener:
    """The address of a viewer, and whether it shows images."""

    address: str
    pictures: bool


class Sender:
    """Sends messages to all listeners. `lost` counts undelivered messages.

    pictures: whether a listener shows images.

    Each listener has its own socket, because unread messages fill the send buffer of the socket they came
    from: a stopped listener would otherwise block all others.
    """

    def __init__(self, listeners: Iterable[Listener] = ()) -> None:
        self.lost = 0
        kind = (socket.AF_UNIX, socket.SOCK_DGRAM)
        self._sockets = [(listener, socket.socket(*kind)) for listener in listeners]
        self.pictures = any(listener.pictures for listener, _ in self._sockets)

    def send(self, kind: str, values: Mapping[str, object], picture: bytes = b"") -> None:
        """Send a message, with an image only to listeners that show images; never blocks, never raises."""
        data = Message(kind, dict(values), picture).pack()
        if len(data) > LARGEST_BYTES:
            self.lost += 1
            return
        for listener, sender in self._sockets:
            if listener.pictures or not picture:
                try:
                    sender.sendto(data, socket.MSG_DONTWAIT, listener.address)
                except OSError:  # the buffer is full, or the listener has ended
                    self.lost += 1

    def close(self) -> None:
        for _, sender in self._sockets:
            sender.close()


class Inbox:
    """Receives messages at an address; a thread reads the socket, so that its buffer does not fill.

    address: a path that does not exist yet, at most 107 bytes long (unix(7)).
    """

    def __init__(self, address: str) -> None:
        self.address = address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind(address)
        self._messages: deque[Message] = deque(maxlen=KEPT_MESSAGES)
        self._thread = threading.Thread(target=self._receive, daemon=True, name="live inbox")
        self._thread.start()

    def take(self) -> list[Message]:
        """Return the messages since the last call, oldest first."""
        messages = []
        with suppress(IndexError):
            while True:
                messages.append(self._messages.popleft())
        return messages

    def close(self) -> None:
        """Read the messages that have arrived, stop receiving, and remove the address."""
        # Closing alone would leave the thread in its system call.
        self._socket.shutdown(socket.SHUT_RD)
        self._thread.join()
        self._socket.close()
        with suppress(FileNotFoundError):
            os.unlink(self.address)

    def _receive(self) -> None:
        while data := self._socket.recv(LARGEST_BYTES):
            try:
                self._messages.append(Message.unpack(data))
            except ValueError:  # a datagram of another program
                continue


@contextmanager
def open_inbox() -> Iterator[Inbox]:
    """Yield an inbox at an address in a temporary folder."""
    with tempfile.TemporaryDirectory(prefix="rig-live-") as folder:
        with closing(Inbox(f"{folder}/inbox")) as inbox:
            yield inbox
