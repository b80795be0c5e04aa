"""Numbers in text tables, in the formats in which other programs write them."""

import math
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from drivers.errors import FormatError
from drivers.formats import (
    MAX_TIME_S,
    number_in,
    parse_csv,
    parse_number,
    parse_time_ns,
    parse_whole,
    read_csv_rows,
)

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


@given(st.one_of(st.text(max_size=8), st.text("+-0123456789.,eE_ naif\x1c\x1f\x85\xa0", max_size=8)))
@example("0\x1f")
def test_any_text_is_rejected_or_has_the_value_that_python_gives_it(text: str) -> None:
    for parse in (parse_number, parse_whole, parse_time_ns):
        try:
            value = parse(text)
        except FormatError:
            continue
        assert value == pytest.approx(float(text) * (10**9 if parse is parse_time_ns else 1), rel=1e-9)


@pytest.mark.parametrize("text", ["0,5", "20,005", "1.234,5", "-1,5E-03", "1,234.5", ",5", "1,234,567"])
def test_decimal_commas_and_thousands_separators_are_rejected_by_name(text: str) -> None:
    with pytest.raises(FormatError, match="has a comma: write numbers with a decimal point"):
        parse_number(text)


@pytest.mark.parametrize(
    "text",
    ["", "nan", "NaN", "inf", "-Infinity", "1e999", "1_000", "0x1f", "1+2i", "12:30", "5 %", "1.0D+00", "−5",
     "١٢"],
)  # fmt: skip
def test_other_texts_are_rejected(text: str) -> None:
    with pytest.raises(FormatError, match=r"is not a number|is too large"):
        parse_number(text)


def test_limits_of_times_and_whole_numbers() -> None:
    assert parse_time_ns("1e-999999999999999999999") == 0
    for text in ("9e9999", "9000000001", "-1e10"):
        with pytest.raises(FormatError, match=r"is beyond 9e\+09 s|is too large"):
            parse_time_ns(text)
    for text, said in (
        ("1.5", "not a whole number"),
        ("9223372036854775808", "64 bits"),
        ("1e30", "64 bits"),
    ):
        with pytest.raises(FormatError, match=said):
            parse_whole(text)


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
