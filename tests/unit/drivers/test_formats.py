"""The readers of file formats: accepted and rejected files, numbers of other programs, time limits."""

import math
import struct
import zlib
from collections.abc import Callable
from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from drivers.errors import FormatError, without_passwords
from drivers.formats import (
    MAX_TIME_S,
    number_in,
    parse_csv,
    parse_json,
    parse_number,
    parse_time_ns,
    parse_toml,
    parse_whole,
    picture,
    picture_flaw,
    quote,
    read_bounded,
    read_csv_rows,
    read_yaml,
    reason,
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


@pytest.mark.heavy
@pytest.mark.parametrize("parse", INVALID, ids=lambda parse: parse.__name__)
def test_invalid_text_is_rejected_quickly_with_its_place(parse: Callable[[Any, str], object]) -> None:
    name = parse.__name__.removeprefix("parse_").upper()
    for text, said in INVALID[parse]:
        with pytest.raises(FormatError, match=rf"^here: .*\b{name}\b") as raised:
            parse(text, "here")
        assert said in str(raised.value), text[:20]


def test_valid_json_and_toml_are_read() -> None:
    value = {"a": [1, -2500.0, "ä😀", None, True]}
    assert parse_json('\ufeff{"a": [1, -2.5e3, "ä\\ud83d\\ude00", null, true]}'.encode(), "") == value
    assert parse_json(b"[9223372036854775807, -9223372036854775808]", "") == [2**63 - 1, -(2**63)]
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


def written_as(suffix: str, image: np.ndarray) -> bytes:
    ok, data = cv2.imencode(suffix, image)
    assert ok
    return data.tobytes()


@pytest.mark.parametrize("side", [12_000, 30_000, 2**31 - 1])
def test_picture_above_the_size_limit_is_rejected_by_its_header(tmp_path: Path, side: int) -> None:
    path = tmp_path / "large.png"
    parts = (
        (b"IHDR", struct.pack(">IIBBBBB", side, side, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(bytes(1000))),
        (b"IEND", b""),
    )
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + b"".join(
            struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
            for kind, body in parts
        )
    )
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


def test_any_changed_byte_of_a_png_and_a_jpeg_with_too_many_scans_are_detected() -> None:
    data = written_as(".png", np.zeros((9, 9, 3), np.uint8))
    for place in range(len(data)):
        damaged = bytearray(data)
        damaged[place] ^= 4
        assert picture_flaw(bytes(damaged)) is not None, place
    data = written_as(".jpg", np.zeros((4000, 4000, 3), np.uint8))
    scan = data.rindex(b"\xff\xda")
    many = data[:scan] + data[scan:-2] * 50 + b"\xff\xd9"
    assert picture_flaw(data) is None
    assert "scans, which exceeds the decoding limit" in str(picture_flaw(many))


def test_error_text_is_short_printable_and_without_passwords() -> None:
    assert len(quote("x" * 10_000)) < 70
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


# numpy.savetxt, Python and pandas, MATLAB's writematrix and its short formats, Excel, C
WRITERS = ("{:.18e}", "{!r}", "{:.15g}", "{:.4e}", "{:.5g}", "{:.2E}", "{:+.9f}", "  {:f} ", "{:.0f}.")
finite = st.floats(allow_nan=False, allow_infinity=False)
times_s = st.floats(-MAX_TIME_S / 2, MAX_TIME_S / 2)


@given(finite, st.sampled_from(WRITERS))
def test_numbers_of_other_programs_have_the_value_that_python_gives_them(value: float, writer: str) -> None:
    text = writer.format(value)
    assume(math.isfinite(float(text)))  # some formats round the largest floats up to infinity
    assert parse_number(text) == float(text)


@given(times_s, st.sampled_from(WRITERS))
@example(20.005, "{:.18e}")
@example(1763000000.123456789, "{:.18e}")
def test_times_keep_their_exponent_and_are_exact_to_the_nanosecond(value: float, writer: str) -> None:
    text = writer.format(value)
    assert abs(Fraction(parse_time_ns(text)) - Fraction(Decimal(text.strip())) * 10**9) <= Fraction(1, 2)


@given(st.integers(-(2**63), 2**63 - 1))
def test_whole_numbers_are_read_in_full(value: int) -> None:
    assert parse_whole(str(value)) == value
    if abs(value) < 2**53:
        assert parse_whole(f"{float(value):.18e}") == parse_whole(f"{value}.0") == value


@pytest.mark.heavy
@given(st.one_of(st.text(max_size=8), st.text("+-0123456789.,eE_ naif\x1c\x1f\x85\xa0", max_size=8)))
@example("0\x1f")
def test_any_text_is_rejected_or_has_the_value_that_python_gives_it(text: str) -> None:
    for parse in (parse_number, parse_whole, parse_time_ns):
        try:
            value = parse(text)
        except FormatError:
            continue
        assert value == pytest.approx(float(text) * (10**9 if parse is parse_time_ns else 1), rel=1e-9)


REJECTED = (
    (parse_number, "has a comma: write numbers with a decimal point",
     ("0,5", "20,005", "1.234,5", "-1,5E-03", "1,234.5", ",5", "1,234,567")),
    (parse_number, "is not a number", ("", "nan", "NaN", "inf", "-Infinity", "1_000", "0x1f", "1+2i", "12:30",
                                       "5 %", "1.0D+00", "−5", "١٢")),
    (parse_number, "is too large", ("1e999",)),
    (parse_time_ns, r"is beyond 9e\+09 s|is too large", ("9e9999", "9000000001", "-1e10")),
    (parse_whole, "not a whole number", ("1.5",)),
    (parse_whole, "64 bits", ("9223372036854775808", "1e30")),
)  # fmt: skip


@pytest.mark.parametrize(("parse", "said", "texts"), REJECTED)
def test_text_that_is_no_number_or_beyond_its_limits_is_rejected(
    parse: Callable[[str], float], said: str, texts: tuple[str, ...]
) -> None:
    for text in texts:
        with pytest.raises(FormatError, match=said):
            parse(text)
    assert parse_time_ns("1e-999999999999999999999") == 0


def test_table_with_two_columns_of_one_name_is_rejected() -> None:
    with pytest.raises(FormatError, match=r"x: has two columns 't_s': remove or rename one"):
        parse_csv("frame,t_s,t_s\n0,0,5\n1,1,6\n", "x")
    assert parse_csv("frame,t_s,,\n0,0,,\n", "x").columns == ("frame", "t_s", "", "")


def test_error_names_the_place_the_column_and_the_text() -> None:
    with pytest.raises(FormatError, match=r"x\.csv: line 2: column a: '1,5' has a comma"):
        number_in({"a": "1,5"}, "a", "x.csv: line 2")
    with pytest.raises(FormatError, match=r"x\.csv: line 2: column b: '' is not a number"):
        number_in({"a": "1"}, "b", "x.csv: line 2")


@pytest.mark.parametrize(
    "text",
    ["a,b\n1,2\n", "a;b\n1;2\n", "a\tb\n1\t2\n", " a , b \n 1 , 2 \n", 'a, "b"\n"1", "2"\n', "# a,b\n1,2\n",
     "# made today\n#a;b\n1;2\n", "a,b,\n1,2,\n", "a,b\r\n1,2\r\n", "\n\na,b\n\n1,2", "a,b\n , \n1,2\n"],
)  # fmt: skip
def test_tables_of_other_programs_have_the_same_rows(text: str) -> None:
    (row,) = (row for _, row in parse_csv(text, "x").rows())
    assert {name: row[name] for name in "ab"} == {"a": "1", "b": "2"}


@pytest.mark.parametrize("text", ["t_s,value\n0,5,1,5\n", "t_s,value\n0.5,1,5\n", "x;y\n1;2;3\n"])
def test_row_with_more_fields_than_the_header_is_rejected(text: str) -> None:
    with pytest.raises(FormatError, match=r"x: line 2 has [34] fields, the header 2: write numbers with a"):
        parse_csv(text, "x")


def test_byte_order_mark_and_text_of_a_spreadsheet_are_read(tmp_path: Path) -> None:
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        path = tmp_path / "x.csv"
        path.write_text("a\tµ\n1\t2\n", encoding=encoding)
        assert read_csv_rows(path, ("a", "µ")) == [(2, {"a": "1", "µ": "2"})]


def test_numpy_header_of_a_table_is_a_comment(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "x.csv", [[0.5, 20.005]], delimiter=",", header="t_s,value")
    ((line, row),) = read_csv_rows(tmp_path / "x.csv", ("t_s", "value"))
    assert (line, parse_time_ns(row["t_s"]), number_in(row, "value", "")) == (2, 500_000_000, 20.005)
