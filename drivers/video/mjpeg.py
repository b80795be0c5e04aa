"""Read an MJPEG stream over HTTP, with deadlines; the JPEG bytes are kept as received.

A server may add to each part the number of the image (`X-Sequence`) and its capture time (`X-Timestamp`, in s
of the server's clock). A server that simulates a sensor names a control address in the header of its answer
(`X-Control`); settings are sent there as JSON, and nowhere else.
"""

import base64
import http.client
import json
import socket
from collections import deque
from collections.abc import Sequence
from typing import Any
from urllib.parse import SplitResult, unquote, urljoin, urlsplit

from drivers.clock import NS_PER_S, Clock, host_s, to_ns
from drivers.errors import DeviceError, FormatError, InputError
from drivers.formats import parse_json, without_passwords
from drivers.video.multipart import MultipartParser, Part, boundary_of
from drivers.video.stream import FrameStream, RawFrame

READ_TIMEOUT_S = 1.5
"""If no image arrives for this long, the server is stuck and the stream is reopened."""
WARM_UP_IMAGES = 10
"""Images to discard after opening, as with a DIGIT (its first ones may be green or dark)."""
_PORTION = 65_536
"""Most bytes read at once."""


class MjpegStream(FrameStream):
    """An open stream. Raises `DeviceError` with the address if the server does not send one.

    A server with a control address starts its sensor for this connection, so the first images are discarded.
    Any other server is already running.
    """

    stamp = "peer"
    ends = False

    def __init__(self, url: str, rate_hz: float, clock: Clock) -> None:
        self._name = without_passwords(url)
        self._clock = clock
        self._timeout_s = max(READ_TIMEOUT_S, 3.0 / rate_hz)
        self._ready: deque[tuple[Part, int]] = deque()
        parts = split_url(url)
        self._connection = _connection(parts, host_s(clock, self._timeout_s))
        self._response: http.client.HTTPResponse | None = None
        self._socket: socket.socket | None = None
        try:
            self._connection.connect()
            self._socket = self._connection.sock
            self._response = _request(self._connection, parts, "GET")
            self._parser = MultipartParser(boundary_of(self._response.getheader("Content-Type", "")))
        except (OSError, http.client.HTTPException, ValueError, DeviceError) as error:
            self.close()
            raise DeviceError(f"{self._name}: {_cause(error)}") from error
        control = self._response.getheader("X-Control")
        self.control_url = None if control is None else urljoin(url, control)
        self.warm_up = 0 if control is None else WARM_UP_IMAGES

    def read(self) -> RawFrame:
        deadline = self._clock.now_ns() + to_ns(self._timeout_s)
        while not self._ready:
            if self._clock.now_ns() > deadline:
                raise DeviceError(
                    f"{self._name}: no image within {self._timeout_s:g} s; is the server stuck?"
                )
            data = self._received()
            now = self._clock.now_ns()
            self._ready.extend((part, now) for part in self._parser.feed(data))
        part, arrived_ns = self._ready.popleft()
        return RawFrame(arrived_ns, part.body, None, _stamp(part.headers), _number(part.headers))

    def configure(self, settings: Sequence[dict[str, Any]]) -> None:
        """Send settings one after the other, if the server accepts settings. Raises `DeviceError`."""
        if self.control_url is not None:
            for setting in settings:
                send_settings(self.control_url, setting, host_s(self._clock, READ_TIMEOUT_S))

    def interrupt(self) -> None:
        if self._socket is not None:
            try:
                self._socket.shutdown(socket.SHUT_RDWR)
            except OSError:
                return

    def close(self) -> None:
        if self._response is not None:
            self._response.close()
        self._connection.close()
        if self._socket is not None:
            self._socket.close()

    def _received(self) -> bytes:
        try:
            data = self._response.read1(_PORTION) if self._response is not None else b""
        except (OSError, http.client.HTTPException, ValueError) as error:
            raise DeviceError(f"{self._name}: {_cause(error)}") from error
        if not data:
            raise DeviceError(f"{self._name}: the server closed the connection; check that it still runs")
        return data


def split_url(url: str) -> SplitResult:
    """Split an HTTP address into its parts. Raises `InputError` for any other address."""
    wrong = InputError(
        f"'{without_passwords(url)}': not an address of the form http://HOST:PORT/PATH; check the bench file"
    )
    try:
        parts = urlsplit(url)
        usable = parts.scheme in ("http", "https") and parts.hostname and parts.port != 0
    except ValueError as error:
        raise wrong from error
    if not usable:
        raise wrong
    return parts


def send_settings(
    control_url: str, settings: dict[str, Any], timeout_s: float = READ_TIMEOUT_S
) -> dict[str, Any]:
    """Send settings to a control address; return its answer. Raises `DeviceError` if rejected."""
    parts = split_url(control_url)
    connection = _connection(parts, timeout_s)
    try:
        body = json.dumps(settings)
        answer = parse_json(_request(connection, parts, "POST", body).read(_PORTION), "its answer")
    except (OSError, http.client.HTTPException, ValueError, FormatError, DeviceError) as error:
        raise DeviceError(
            f"{without_passwords(control_url)}: settings {settings} failed: {_cause(error)}"
        ) from error
    finally:
        connection.close()
    return answer if isinstance(answer, dict) else {}


def _connection(parts: SplitResult, timeout_s: float) -> http.client.HTTPConnection:
    kind = http.client.HTTPSConnection if parts.scheme == "https" else http.client.HTTPConnection
    return kind(parts.hostname or "", parts.port, timeout=timeout_s)


def _request(
    connection: http.client.HTTPConnection, parts: SplitResult, method: str, body: str | None = None
) -> http.client.HTTPResponse:
    path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    headers = {"Content-Type": "application/json"} if body is not None else {}
    if parts.username is not None:
        login = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
        headers["Authorization"] = "Basic " + base64.b64encode(login.encode()).decode()
    connection.request(method, path, body, headers)
    response = connection.getresponse()
    if response.status != http.client.OK:
        raise DeviceError(f"the server answers {response.status} {response.reason}; check the address")
    return response


def _cause(error: Exception) -> str:
    if isinstance(error, TimeoutError):
        return f"no answer within {READ_TIMEOUT_S:g} s; check that the server runs"
    if isinstance(error, ConnectionRefusedError):
        return "the connection was refused; start the server or check the port"
    if isinstance(error, socket.gaierror):
        return "the name of the server cannot be resolved; check the address and the network"
    if isinstance(error, DeviceError | FormatError):
        return str(error)
    return f"{type(error).__name__} {error}; check the server"


def _stamp(headers: dict[str, str]) -> int | None:
    """Convert `X-Timestamp` to ns. A float would be too coarse, because the time may count from 1970."""
    whole, _, fraction = headers.get("x-timestamp", "").partition(".")
    if not (whole.isascii() and whole.isdecimal() and len(whole) < 12):
        return None
    if fraction and not (fraction.isascii() and fraction.isdecimal()):
        return None
    return int(whole) * NS_PER_S + int(fraction[:9].ljust(9, "0"))


def _number(headers: dict[str, str]) -> int | None:
    text = headers.get("x-sequence", "")
    return int(text) if text.isascii() and text.isdecimal() and len(text) < 16 else None
