"""Motion JPEG over HTTP: parse the parts of a multipart stream from bytes in any portions.

`multipart/x-mixed-replace` is MIME multipart (RFC 2046, 5.1) in which each part replaces the last. Servers
differ: with or without Content-Length, quoted boundaries, boundaries announced with their leading dashes,
bare line feeds. Only a stream without any part raises an error.

Existing readers do not fit: OpenCV's video capture returns neither the bytes as received nor the part's
headers. Parsers of MIME multipart deliver a part only after the next delimiter, which many cameras send with
the next image, one period later.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from email.message import Message

from drivers.errors import DamagedFrameError, DeviceError
from drivers.video.decode import read_header

MAX_HEADER = 16_384
"""Size limit of the header of one part, bytes."""
MAX_PART = 16_777_216
"""Size limits of a part's header and body in bytes."""
_HEADER_END = re.compile(rb"\r?\n\r?\n")
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
        self._searched = 0
        self._coded = 0

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
        while (start := self._buffer.find(self._delimiter)) >= 0:
            line_end = self._buffer.find(b"\n", start)
            end = _HEADER_END.search(self._buffer, line_end - 1 if line_end > 0 else len(self._buffer))
            if end is None and len(self._buffer) - start <= MAX_HEADER:
                self._drop(start)
                return False
            if end is not None and end.start() - start <= MAX_HEADER:
                if self._delimiter == b"--":
                    self._delimiter = bytes(self._buffer[start:line_end]).rstrip()
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
            self._coded = _coded_from(self._buffer)
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


def _coded_from(data: bytearray) -> int:
    """Return the offset of a JPEG's coded data; 0 while its header is incomplete or if it is damaged."""
    try:
        return read_header(data)[1]
    except DamagedFrameError:
        return 0
