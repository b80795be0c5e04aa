"""Check image files before they are decoded: their size in pixels, and whether they are complete.

Decoders allocate as many pixels as a header of a few bytes states, and silently return the readable part of
a truncated image. Pillow also reads sizes, but it decodes WebP for that, and checks for large images only on
opening.

JPEG: ITU-T T.81, table B.1. PNG: ISO/IEC 15948, 5.3. TIFF: revision 6.0, section 2, and
BigTIFF (libtiff.gitlab.io/libtiff/specification/bigtiff.html). WebP: RFC 9649, 2.
"""

import math
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress

from drivers.errors import FormatError
from drivers.formats.unpacking import check_unpacked

MOST_PIXELS = 50_000_000
"""Largest image that is decoded, px."""
MOST_SCANS = 12
"""Largest number of scans of an image of MOST_PIXELS: a progressive JPEG has about ten."""
_PNG, _PNG_HEAD = b"\x89PNG\r\n\x1a\n", struct.Struct(">I4s")
_JPEG, _JPEG_END, _JPEG_SCAN = b"\xff\xd8", b"\xff\xd9", b"\xff\xda"
_NO_SIZE = (0xC4, 0xC8, 0xCC)
"""Markers from C0 to CF that are not frame headers: Huffman tables, reserved, arithmetic coding."""
_WIDTH, _HEIGHT, _BITS, _SAMPLES, _TILE_WIDTH, _TILE_HEIGHT, _SUBFILE = 256, 257, 258, 277, 322, 323, 254
_FORMAT, _FLOAT = 339, 3
_EXIF, _ORIENTATION = b"Exif\0\0", 274
"""Begins the TIFF data in a JPEG (EXIF 2.3, 4.7.2); the tag of the orientation in them."""
_SHORT, _LONG, _LESS_RESOLUTION = 3, 4, 1
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""Beginnings of TIFF and of BigTIFF, in both byte orders."""
_MOST_PAGES = 10_000
_PNG_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Samples per pixel by the colour type of a PNG."""
Size = tuple[int, int]
Tags = dict[int, int]


def picture_flaw(data: bytes) -> str | None:
    """Return why an image must not be decoded; None if it is accepted.

    Rejects data that are not PNG, JPEG, BMP, TIFF or WebP, are truncated, have a wrong checksum (PNG), have
    more than `MOST_PIXELS`, or contain several pictures, of which only the first would be decoded.
    """
    try:
        read = next((read for begin, read in _KINDS if data.startswith(begin)), None)
        if read is None:
            return "is not a picture: neither PNG, JPEG, BMP, TIFF nor WebP"
        width, height = read(data)
        if (count := picture_count(data)) > 1:
            return f"holds {count} images, but only one would be read: give a folder of images"
        if 0 < width * height <= MOST_PIXELS:
            check_unpacked("its pixels", len(data), width * height * _pixel_bytes(data))
    except FormatError as error:
        return str(error)
    except (struct.error, IndexError):
        return "is not a complete picture: its header is truncated"
    if not 0 < width * height <= MOST_PIXELS or min(width, height) < 0:
        return f"is {width} x {height} px; at most {MOST_PIXELS // 1_000_000} megapixels are read"
    return None


def picture_count(data: bytes) -> int:
    """Return the number of pictures in a file: pages of a TIFF, frames of an animated PNG or WebP; else 1.

    Pages that are smaller copies of others are not counted. Raises `FormatError` for more than 10,000 pages.
    """
    if data.startswith(_TIFF):
        count = 0
        with suppress(struct.error):  # a truncated header is a flaw, but no second picture
            for page in _pages(data):
                count += not page.get(_SUBFILE, 0) & _LESS_RESOLUTION
        return max(count, 1)
    if data.startswith(_PNG):
        at = data.find(b"acTL", 0, max(data.find(b"IDAT"), 0))
        return int.from_bytes(data[at + 4 : at + 8], "big") if at > 0 else 1
    if data.startswith(b"RIFF") and data[12:16] == b"VP8X":
        return max(data.count(b"ANMF"), 1)
    return 1


def holds_floats(data: bytes) -> bool:
    """Whether an accepted image is a TIFF with floating-point samples."""
    if not data.startswith(_TIFF):
        return False
    with suppress(struct.error):
        return _of_first_sample(data, next(_pages(data)), _FORMAT) == _FLOAT
    return False


def jpeg_orientation(beginning: bytes) -> int:
    """Return the EXIF orientation of a JPEG by its first bytes: 1 for upright or unknown, to 8."""
    at = beginning.find(_EXIF)
    if at > 0 and beginning.startswith(_JPEG):
        with suppress(struct.error, StopIteration, FormatError):
            return next(_pages(beginning[at + len(_EXIF) :])).get(_ORIENTATION, 1)
    return 1


def may_hold_several(beginning: bytes) -> bool:
    """Whether a file that begins so may contain several pictures. A PNG states it before its pixels."""
    if beginning.startswith(_PNG):
        return b"acTL" in beginning or b"IDAT" not in beginning
    return beginning.startswith((*_TIFF, b"RIFF"))


def jpeg_header(data: bytes | bytearray) -> tuple[Size, int]:
    """Return (width, height) in px and the offset of the coded data in bytes. Raises `FormatError`."""
    size: Size | None = None
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        marker, length = data[at + 1], int.from_bytes(data[at + 2 : at + 4], "big")
        if marker == 0xFF:
            at += 1
            continue
        if 0xC0 <= marker <= 0xCF and marker not in _NO_SIZE and at + 9 <= len(data):
            size = int.from_bytes(data[at + 7 : at + 9], "big"), int.from_bytes(data[at + 5 : at + 7], "big")
        at += 2 + max(length, 2)
        if marker == _JPEG_SCAN[1]:
            return size or (0, 0), at
    raise FormatError(f"is not a complete picture: its header is damaged at byte {at}")


def _jpeg(data: bytes) -> Size:
    size, scan = jpeg_header(data)
    # only in the second half: a preview in the header has an end marker as well
    if data.rfind(_JPEG_END, scan) < len(data) // 2:
        raise FormatError("is not a complete picture: its end is missing")
    scans = data.count(_JPEG_SCAN, scan) + 1
    if scans * size[0] * size[1] > MOST_SCANS * MOST_PIXELS:
        raise FormatError(f"is {size[0]} x {size[1]} px in {scans} scans, which exceeds the decoding limit")
    return size


def _png(data: bytes) -> Size:
    at, kind = len(_PNG), b""
    while kind != b"IEND":
        if at + 12 > len(data):
            raise FormatError("is not a complete picture: its end is missing")
        length, kind = _PNG_HEAD.unpack_from(data, at)
        end = at + 8 + length
        if end + 4 > len(data):
            raise FormatError("is not a complete picture: its end is missing")
        if zlib.crc32(memoryview(data)[at + 4 : end]) != int.from_bytes(data[end : end + 4], "big"):
            raise FormatError(f"is damaged: the checksum at byte {end} differs")
        at = end + 4
    width, height = struct.unpack_from(">II", data, 16)
    return width, height


def _bmp(data: bytes) -> Size:
    if struct.unpack_from("<I", data, 14)[0] == 12:  # header of OS/2 version 1
        width, height = struct.unpack_from("<HH", data, 18)
    else:
        width, height = struct.unpack_from("<ii", data, 18)
    return width, abs(height)


def _tiff(data: bytes) -> Size:
    """Return the size of the first picture in a TIFF file, or of its tiles if they are larger."""
    tags = next(_pages(data))
    tile = tags.get(_TILE_WIDTH, 0), tags.get(_TILE_HEIGHT, 0)
    return max((tags.get(_WIDTH, 0), tags.get(_HEIGHT, 0)), tile, key=math.prod)


def _pages(data: bytes) -> Iterator[Tags]:
    """Yield the tags of each picture of a TIFF file. Raises `FormatError` for a loop."""
    order, big = "<" if data.startswith(b"II") else ">", data.startswith(_TIFF[2:])
    # Where the first directory's offset is, codes of offsets and of the number of tags, and sizes of these.
    first, offset, number, head, entry_size = (8, "Q", "Q", 8, 20) if big else (4, "I", "H", 2, 12)
    (at,) = struct.unpack_from(f"{order}{offset}", data, first)
    seen: set[int] = set()
    while at:
        if at in seen or len(seen) >= _MOST_PAGES:
            raise FormatError(f"holds more than {len(seen)} images: give a folder of images")
        seen.add(at)
        (count,) = struct.unpack_from(f"{order}{number}", data, at)
        end, tags = at + head + entry_size * count, Tags()
        for entry in range(at + head, min(end, len(data)), entry_size):
            tag, kind, values = struct.unpack_from(f"{order}HH{offset}", data, entry)
            # Values that do not fit into the entry are elsewhere, and the entry has their offset.
            short = kind == _SHORT and values <= (4 if big else 2)
            code = "H" if short else "I" if kind == _LONG and values == 1 else offset
            (tags[tag],) = struct.unpack_from(f"{order}{code}", data, entry + entry_size - (8 if big else 4))
        yield tags
        (at,) = struct.unpack_from(f"{order}{offset}", data, end)


def _pixel_bytes(data: bytes) -> int:
    """Return the bytes of a decoded pixel: more than 3 in a PNG or TIFF with many or deep samples."""
    if data.startswith(_PNG):
        return -(-data[24] * _PNG_CHANNELS.get(data[25], 4) // 8)
    if not data.startswith(_TIFF):
        return 3
    tags = next(_pages(data))
    return -(-tags.get(_SAMPLES, 1) * _of_first_sample(data, tags, _BITS) // 8)


def _of_first_sample(data: bytes, tags: Tags, tag: int) -> int:
    """Return, for the first sample, a TIFF tag that has one value per sample; 1 if it is missing."""
    value = tags.get(tag, 1)
    most = 4 if data.startswith(_TIFF[2:]) else 2
    if tag not in tags or tags.get(_SAMPLES, 1) <= most:
        return value
    # more values than fit into the entry, which then has their offset
    (value,) = struct.unpack_from("<H" if data.startswith(b"II") else ">H", data, value)
    return value


def _webp(data: bytes) -> Size:
    kind = data[12:16]
    if data[8:12] != b"WEBP":
        raise FormatError("is not a picture: neither PNG, JPEG, BMP, TIFF nor WebP")
    if kind == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, height = struct.unpack_from("<HH", data, 26)
    return width & 0x3FFF, height & 0x3FFF


_KINDS: tuple[tuple[bytes, Callable[[bytes], Size]], ...] = (
    (_PNG, _png), (_JPEG, _jpeg), (b"BM", _bmp), *((begin, _tiff) for begin in _TIFF), (b"RIFF", _webp),
)  # fmt: skip
