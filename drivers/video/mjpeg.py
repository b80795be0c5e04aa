"""Read an MJPEG stream over HTTP, with deadlines; the JPEG bytes are kept as received.

A server may add to each part the number of the image (`X-Sequence`) and its capture time (`X-Timestamp`, in s
of the server's clock). A server that simulates a sensor names a control address in the header of its answer
(`X-Control`); settings are sent there as JSON, and nowhere else.

`multipart/x-mixed-replace` is MIME multipart (RFC 2046, 5.1) in which each part replaces the last. Servers
differ: with or without Content-Length, or with one that is too small, quoted boundaries, boundaries announced
with their leading dashes or other than those that are sent, bare line feeds. Only a stream without any part
raises an error. Existing readers do not fit: OpenCV's video capture returns neither the bytes as received nor
the part's headers, and parsers of MIME multipart deliver a part only after the next delimiter, which many
cameras send with the next image, one period later.
"""

import base64
import http.client
import json
import re
import socket
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from email.message import Message
from typing import Any
from urllib.parse import SplitResult, unquote, urljoin, urlsplit

from drivers.clock import NS_PER_S, Clock, host_s, to_ns
from drivers.errors import DamagedFrameError, DeviceError, FormatError, InputError, without_passwords
from drivers.formats import parse_json
from drivers.video.stream import WARM_UP_IMAGES, FrameStream, RawFrame, read_header

MAX_HEADER = 16_384
"""Size limit of the header of one part, bytes."""
MAX_PART = 16_777_216
"""Size limit of the body of one part, bytes."""
_HEADER_END = re.compile(rb"\r?\n\r?\n")
_OTHER_DELIMITER = re.compile(rb"--[^\r\n]{1,70}(?=\r?\ncontent-(type|length):)", re.IGNORECASE)
"""A delimiter line with the first header of its part."""
_JPEG_START, _JPEG_END = b"\xff\xd8", b"\xff\xd9"
_RETURN = 0x0D
"""Byte of a carriage return."""


@dataclass(frozen=True, slots=True)
class Part:
    """One part: its headers (lower-case names) and its body."""

    headers: dict[str, str]
    body: bytes


def boundary_of(content_type: str) -> bytes:
    """Return the start of a delimiter line, `--` and the boundary; `--` alone if no boundary is announced.

    Raises `DeviceError` if the type is not multipart.
    """
    message = Message()
    message["Content-Type"] = content_type
    if message.get_content_maintype() != "multipart":
        raise DeviceError(
            f"it sends '{content_type[:80]}', not a multipart MJPEG stream; check the path of the address"
        )
    boundary = (message.get_boundary() or "").encode("latin-1", "replace")
    return boundary if boundary.startswith(b"--") else b"--" + boundary


class MultipartParser:
    """Parses the bytes of a stream as they arrive, and yields each part as soon as it is complete.

    A part without Content-Length ends at the end of its JPEG, or at the next delimiter. Bytes between parts
    are skipped, so that the parser resynchronises after a damaged part.
    """

    def __init__(self, delimiter: bytes) -> None:
        self._delimiter = delimiter
        self._buffer = bytearray()
        self._headers: dict[str, str] | None = None
        self._searched = self._coded = 0
        self._confirmed = False

    def feed(self, data: bytes) -> Iterator[Part]:
        """Add bytes; yield the parts that they complete. Raises `DeviceError` if there are no parts."""
        self._buffer += data
        while True:
            if self._headers is None and not self._find_headers():
                break
            part = self._find_body()
            if part is None:
                break
            yield part
        if len(self._buffer) > 2 * MAX_PART:
            raise DeviceError("no part of it ends; it is not an MJPEG stream")

    def _find_headers(self) -> bool:
        """Read up to a part's body; return False while the header is incomplete."""
        if not self._confirmed and self._buffer.find(self._delimiter) < 0:
            if found := _OTHER_DELIMITER.search(self._buffer):
                self._delimiter = found[0]
        while (start := self._buffer.find(self._delimiter)) >= 0:
            line_end = self._buffer.find(b"\n", start)
            end = _HEADER_END.search(self._buffer, line_end - 1 if line_end > 0 else len(self._buffer))
            if end is None and len(self._buffer) - start <= MAX_HEADER:
                self._drop(start)
                return False
            if end is not None and end.start() - start <= MAX_HEADER:
                if self._delimiter == b"--":
                    self._delimiter = bytes(self._buffer[start:line_end]).rstrip()
                self._confirmed = True
                self._headers = _headers(bytes(self._buffer[line_end + 1 : max(end.start(), line_end + 1)]))
                self._drop(end.end())
                return True
            self._drop(start + len(self._delimiter))
        self._drop(max(len(self._buffer) - len(self._delimiter), 0))
        return False

    def _find_body(self) -> Part | None:
        text = (self._headers or {}).get("content-length", "")
        length = int(text) if text.isascii() and text.isdecimal() and len(text) < 12 else 0
        announced = length if 0 < length <= MAX_PART else None
        if announced is not None and len(self._buffer) >= announced:
            body = self._buffer[:announced]
            # A JPEG that does not end there: some servers announce too few bytes.
            cut = body.startswith(_JPEG_START) and not body.rstrip(b"\r\n\0").endswith(_JPEG_END)
            announced = None if cut else announced
        end = announced if announced is not None else self._body_end()
        if end is None or len(self._buffer) < end:
            if len(self._buffer) > MAX_PART:
                self._headers = None
                self._searched = self._coded = 0
            return None
        part = Part(self._headers or {}, bytes(self._buffer[:end]))
        self._headers = None
        self._drop(end)
        return part

    def _body_end(self) -> int | None:
        """Return where a body of unknown length ends: with its JPEG, at the latest before a delimiter."""
        if self._coded == 0 and self._buffer[:2] == _JPEG_START:
            with suppress(DamagedFrameError):  # also while its header is incomplete
                self._coded = read_header(self._buffer)[1]
        line = b"\n" + self._delimiter
        image_end = self._buffer.find(_JPEG_END, max(self._searched, self._coded)) if self._coded else -1
        found = self._buffer.find(line, self._searched, image_end if image_end >= 0 else len(self._buffer))
        if found >= 0:
            return found - 1 if found > 0 and self._buffer[found - 1] == _RETURN else found
        if image_end >= 0:
            return image_end + len(_JPEG_END)
        self._searched = max(len(self._buffer) - len(line), 0)
        return None

    def _drop(self, count: int) -> None:
        del self._buffer[:count]
        self._searched = self._coded = 0


def _headers(block: bytes) -> dict[str, str]:
    pairs = (line.partition(":") for line in block.decode("latin-1").splitlines())
    return {name.strip().lower(): value.strip() for name, colon, value in pairs if colon}


READ_TIMEOUT_S = 1.5
"""If no image arrives for this long, the server is stuck and the stream is reopened."""
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
        connection = _connection(parts, host_s(clock, self._timeout_s))
        self._opened = ExitStack()
        self._opened.callback(connection.close)
        try:
            connection.connect()
            self._socket = self._opened.enter_context(connection.sock)
            self._response = self._opened.enter_context(_request(connection, parts, "GET"))
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
            try:
                data = self._response.read1(_PORTION)
            except (OSError, http.client.HTTPException, ValueError) as error:
                raise DeviceError(f"{self._name}: {_cause(error)}") from error
            if not data:
                raise DeviceError(f"{self._name}: the server closed the connection; check that it still runs")
            now = self._clock.now_ns()
            self._ready.extend((part, now) for part in self._parser.feed(data))
        part, arrived_ns = self._ready.popleft()
        text = part.headers.get("x-sequence", "")
        number = int(text) if text.isascii() and text.isdecimal() and len(text) < 16 else None
        return RawFrame(arrived_ns, part.body, None, _stamp(part.headers), number)

    def configure(self, settings: Sequence[dict[str, Any]]) -> None:
        """Send settings one after the other, if the server accepts settings. Raises `DeviceError`."""
        if self.control_url is not None:
            for setting in settings:
                send_settings(self.control_url, setting, host_s(self._clock, READ_TIMEOUT_S))

    def interrupt(self) -> None:
        with suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        self._opened.close()


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
    if response.status == http.client.UNAUTHORIZED:
        why = "asks for a name and password" if parts.username is None else "rejects the name or the password"
        raise DeviceError(
            f"the server {why}: give them in the address, as http://NAME:PASSWORD@HOST:PORT/PATH"
        )
    if (place := response.getheader("Location")) and 300 <= response.status < 400:
        here = parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()
        raise DeviceError(f"the stream has moved: give the address {without_passwords(urljoin(here, place))}")
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
