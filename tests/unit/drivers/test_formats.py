"""The readers of file formats: accepted files, rejected files, and time limits."""

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from drivers.errors import FormatError
from drivers.formats import (
    parse_csv,
    parse_json,
    parse_toml,
    picture,
    picture_flaw,
    read_bounded,
    read_yaml,
    reason,
    shown,
    without_passwords,
)
from drivers.images import decode_image, image_flaw, load_image

INVALID = {
    parse_json: [
        (b"[" * 100_000, "nested too deeply"), (b"1" * 6000, "a number of 6000 digits"),
        (b"[NaN]", "NaN is not a number"), (b"-Infinity", "-Infinity is not a number"),
        (b"1e999", "too large"), (b'"\\ud800"', "surrogates"), (b"\xff", "invalid start byte"),
        (b"", "Expecting value"), (b'{"a":', "Expecting value"), (b"{} {}", "Extra data"),
    ],
    parse_toml: [
        ("a = " + "[" * 50_000, "nested too deeply"), ("a = " + "1" * 6000, "4300 digits"),
        ("a = 2026-02-31", "Invalid date"), ("a" + ".a" * 30_000 + " = 1", "a key of more than 16 parts"),
        ("[" + "a." * 30_000 + "a]", "a key of more than 16 parts"),
        ('"\u2028"' + '."\u2028"' * 30_000 + "=1", "a key of more than 16 parts"), ("a = ", "Invalid value"),
        ("a = " + "{a=" * 5000 + "1" + "}" * 5000, "nested too deeply"),
    ],
    parse_csv: [
        ("a,b\n" + "x" * 200_000, "field larger than"), ("a\n" + "1\n" * 500_002, "more than 500000"),
        ("," * 3_000_001, "3000000 fields"),
    ],
}  # fmt: skip
"""Invalid texts by their parser, and words of the reason."""


@pytest.mark.parametrize("parse", INVALID, ids=lambda parse: parse.__name__)
def test_invalid_text_is_rejected_quickly_with_its_place(parse: Callable[[Any, str], object]) -> None:
    name = parse.__name__.removeprefix("parse_").upper()
    for text, said in INVALID[parse]:
        with pytest.raises(FormatError, match=rf"^here: .*\b{name}\b") as raised:
            parse(text, "here")
        assert said in str(raised.value), text[:20]


def test_valid_json_is_read() -> None:
    assert parse_json('\ufeff{"a": [1, -2.5e3, "ä\\ud83d\\ude00", null, true]}'.encode(), "") == {
        "a": [1, -2500.0, "ä😀", None, True]
    }
    assert parse_json(b"[9223372036854775807, -9223372036854775808]", "") == [2**63 - 1, -(2**63)]


def test_dots_in_numbers_and_comments_are_not_counted_as_keys() -> None:
    numbers = ", ".join(["0.5"] * 40)
    text = f"a = [{numbers}]\n# {'one. ' * 30}\nb = 'x.y'\nc.d.e = 1.0\n"
    assert len(parse_toml(text, "")["a"]) == 40


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[" * 5000, "nested too deeply"), ("a: " + "1" * 6000, "a number of 6000 digits"),
        ("a: " + "1:" * 3000 + "1", "digits"), ("a: " + "1:" * 3000 + "1.5", "too large"),
        ("a: &a [1]\nb: *a", "line 2: an alias"), ("a: !!timestamp x", "an unknown kind of value"),
        ("a: !!python/object:os.system x", "an unknown kind of"), ("a: 1\n---\nb: 2", "single document"),
        ("{[1]: 2}", "unhashable"), ("a: \x00", "control characters"), ("a: 0x_", "base 0"),
        ("a: =", "could not determine"), ("\tb", "cannot start any token"),
    ],
)  # fmt: skip
def test_invalid_yaml_is_rejected_with_its_place(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "x.yaml"
    path.write_text(text)
    with pytest.raises(FormatError, match=r"x\.yaml: is not valid YAML") as raised:
        read_yaml(path)
    assert said in str(raised.value)


def test_valid_yaml_is_read(tmp_path: Path) -> None:
    path = tmp_path / "x.yaml"
    path.write_text(
        "%YAML:1.0\n---\nmade: 2026-13-45\nwhole: [7, -1_000, 0x1f, 017]\n"
        "m: !!opencv-matrix\n  rows: 1\n  data: [1., 2.5e-3]\n"
    )
    matrix = {"rows": 1, "data": [1.0, 0.0025]}
    assert read_yaml(path) == {"made": "2026-13-45", "whole": [7, -1000, 31, 15], "m": matrix}


def test_valid_csv_is_read() -> None:
    table = parse_csv('# made by hand\n a ;b\n\n1;"x\ny"\n2\n3;4;\n', "here")
    assert list(table.rows()) == [
        (5, {"a": "1", "b": "x\ny"}), (6, {"a": "2", "b": ""}), (7, {"a": "3", "b": "4"}),
    ]  # fmt: skip
    with pytest.raises(FormatError, match="here: line 1 has no column c: it needs a, c and has a, b"):
        table.require("a", "c")


def test_file_above_the_size_limit_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(bytes(1001))
    with pytest.raises(FormatError, match=r"is larger than the size limit of 0\.001 MB"):
        read_bounded(path, 1000)
    with pytest.raises(FormatError, match="No such file"):
        read_bounded(tmp_path / "none", 1000)
    with pytest.raises(FormatError, match="null byte"):
        read_bounded(Path("a\0b"), 1000)


def png_of(width: int, height: int, data: bytes = b"") -> bytes:
    """A PNG whose header states a large size, with almost no data."""
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
        for kind, body in (
            (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
            (b"IDAT", data or zlib.compress(bytes(1000))),
            (b"IEND", b""),
        )
    )


def written_as(suffix: str, image: np.ndarray) -> bytes:
    ok, data = cv2.imencode(suffix, image)
    assert ok
    return data.tobytes()


@pytest.mark.parametrize("side", [12_000, 30_000, 2**31 - 1])
def test_picture_above_the_size_limit_is_rejected_by_its_header(tmp_path: Path, side: int) -> None:
    path = tmp_path / "large.png"
    path.write_bytes(png_of(side, side))
    assert image_flaw(path) == f"is {side} x {side} px; at most 50 megapixels are read"
    assert load_image(path) is None


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif", ".webp"])
def test_sizes_are_known_before_pictures_are_decoded(suffix: str, monkeypatch: pytest.MonkeyPatch) -> None:
    image = np.random.default_rng(0).integers(0, 255, (33, 47, 3)).astype(np.uint8)
    data = written_as(suffix, image)
    assert picture_flaw(data) is None
    decoded = decode_image(data)
    assert decoded is not None
    assert decoded.shape == (33, 47, 3)
    monkeypatch.setattr(picture, "MOST_PIXELS", 33 * 47 - 1)
    assert str(picture_flaw(data)).startswith("is 47 x 33 px")
    assert decode_image(data) is None
    for length in range(0, 30):
        assert picture_flaw(data[:length]) is not None


def test_any_changed_byte_of_a_png_is_detected() -> None:
    data = written_as(".png", np.zeros((9, 9, 3), np.uint8))
    for place in range(len(data)):
        damaged = bytearray(data)
        damaged[place] ^= 4
        assert picture_flaw(bytes(damaged)) is not None, place


def test_jpeg_with_too_many_scans_is_not_decoded() -> None:
    data = written_as(".jpg", np.zeros((4000, 4000, 3), np.uint8))
    scan = data.rindex(b"\xff\xda")
    many = data[:scan] + data[scan:-2] * 50 + b"\xff\xd9"
    assert picture_flaw(data) is None
    assert "scans, which exceeds the decoding limit" in str(picture_flaw(many))


def test_error_text_is_short_printable_and_without_passwords() -> None:
    assert len(shown("x" * 10_000)) < 70
    assert len(reason(ValueError("x" * 10_000))) < 170
    assert "\n" not in reason(ValueError("two\nlines \ud800"))
    reason(ValueError("\ud800")).encode()
    for text, hidden in (
        ("http://me:s3cret@cam/a", "http://me:***@cam/a"),
        ("at rtsp://me:p:a@ss@cam", "at rtsp://me:***@cam"),
        ("http://cam/x?user=me&password=s3cret&n=1", "http://cam/x?user=me&password=***&n=1"),
        ("http://cam/x?Token=abc", "http://cam/x?Token=***"),
        ("http://me@cam/a and 12:30 a@b", "http://me@cam/a and 12:30 a@b"),
    ):
        assert without_passwords(text) == hidden
