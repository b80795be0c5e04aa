"""Every reader of a format returns a value or raises its typed error within a second, for any bytes."""

import json
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given

from drivers.formats import parse_csv, parse_json, parse_toml, picture_flaw, read_yaml
from drivers.images import decode_image
from support.fuzz import answered, changed, fuzzed

ROOT = Path(__file__).parents[3]
NUMBERS = (b"9" * 30, b"1e999", b"-0", b"1_0", b"0x1f", b"1:2:3", b"2026-02-31", b".5", b"NaN", b".inf")
BRACKETS = (b"[", b"]", b"{", b"}", b"[" * 60, b"{" * 60, b'"', b"'", b'"""', b"\\", b"\\ud800")
SIGNS = (b":", b": ", b",", b"\n", b"\n\n", b"=", b".", b".a" * 40, b"#", b"-", b"- ", b"? ", b"&a ", b"*a ",
         b"!!", b"!!timestamp ", b"!<x> ", b"%YAML:1.0\n", b"---\n", b"|\n", b">", b"\t", b"\r",
         b"\xe2\x80\xa8", b"\xef\xbb\xbf", b"\0", b"\xff", b"\xc3", b"null", b"~", b"<<: ")  # fmt: skip
PIECES = (*NUMBERS, *BRACKETS, *SIGNS)
JSON = (ROOT / "tests/data/stored_record/poses.jsonl").read_bytes().splitlines()[0]
TOML = b'name = "lab"\n[arm]\nhome_m = [0.1, -0.2, 3e-1]\nat = 2026-01-01T00:00:00Z\n[[t]]\na.b = {c = 1}\n'
YAML = (
    b"image_width: 640\ncamera_matrix:\n  rows: 3\n  data: [1.0, 2, 0x1f]\n"
    b"calibration: {schema: 1, created: '2026-01-01', verdict: good, quality: {a: [b, c]}}\n"
)
CSV = b'# by hand\nframe,t_s,"note"\n1,0.5,a\n2,0.6,"b ""c"" d"\n'


@fuzzed()
@given(changed([JSON, b"[1, -2.5e3, null]", TOML], PIECES))
def test_json_and_toml(data: bytes) -> None:
    value = answered(lambda: parse_json(data, "x"))
    if value is not None:
        json.dumps(value, allow_nan=False).encode()
    tables = answered(lambda: parse_toml(data.decode("utf-8", "replace"), "x"))
    assert tables is None or isinstance(tables, dict)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz") / "x"


@fuzzed()
@given(data=changed([YAML], PIECES))
def test_yaml(file: Path, data: bytes) -> None:
    file.write_bytes(data)
    value = answered(lambda: read_yaml(file))
    assert len(repr(value)) < 20 * len(data) + 1000  # no entity expands to more than its own length


@fuzzed()
@given(changed([CSV, CSV.replace(b",", b";")], (*PIECES, b"," * 300, b"x" * 140_000)))
def test_csv(data: bytes) -> None:
    table = answered(lambda: parse_csv(data.decode("utf-8", "replace"), "x"))
    if table is not None:
        for line, row in table.rows():  # type: ignore[attr-defined]
            assert line > 0
            assert tuple(row) == tuple(dict.fromkeys(table.columns))  # type: ignore[attr-defined]


@cache
def pictures() -> tuple[bytes, ...]:
    image = np.arange(12 * 10 * 3, dtype=np.uint8).reshape(12, 10, 3)
    encoded = [cv2.imencode(suffix, image) for suffix in (".png", ".jpg", ".bmp", ".tif", ".webp")]
    progressive = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    return tuple(data.tobytes() for _, data in (*encoded, progressive))


SIZES = (
    b"\xff\xff",
    b"\x7f\xff\xff\xff",
    b"\0\0\x75\x30",
    b"\x30\x75\0\0",
    b"\xff\xc0",
    b"\xff\xda",
    b"\xff\xd9",
)


@fuzzed()
@given(changed(pictures(), (*SIZES, b"", b"\0", b"\xff", b"IEND", b"IHDR", b"\0" * 8)))
def test_pictures(data: bytes) -> None:
    image = answered(lambda: decode_image(data))
    if image is not None:
        assert picture_flaw(data) is None
        assert image.dtype == np.uint8  # type: ignore[attr-defined]
        assert image.size <= 3 * 50_000_000  # type: ignore[attr-defined]
