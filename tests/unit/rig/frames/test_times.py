"""When frames were taken: a table with one row per frame, or a rate."""

from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import InputError
from rig.frames.times import parse_time, times_from_table

NAMES = ["a1.png", "a2.png", "b.png"]


def table(folder: Path, *lines: str) -> Path:
    path = folder / "times.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


@pytest.mark.parametrize(
    "frames", [("a1.png", "a2.png", "b.png"), ("a1", "a2", "b"), ("0", "1", "2"), ("00", "1.0", "2.00e+00")]
)
def test_a_row_names_its_frame_by_file_stem_or_number(tmp_path: Path, frames: tuple[str, ...]) -> None:
    path = table(tmp_path, "frame,t_s", *(f"{frame},{0.5 * i}" for i, frame in enumerate(frames)))
    assert [time.time_ns for time in times_from_table(path, NAMES)] == [0, 500_000_000, 1_000_000_000]


def test_time_keeps_its_text_and_its_exact_value(tmp_path: Path) -> None:
    texts = ["1732175999.123456789", "1.7321760000e9", "+1732176000.50"]
    path = table(tmp_path, "frame,note,t_s", *(f"{n},x, {t} " for n, t in zip(NAMES, texts, strict=True)))
    times = times_from_table(path, NAMES)
    assert [time.text for time in times] == texts
    assert [time.time_ns for time in times] == [
        1732175999123456789, 1732176000000000000, 1732176000500000000
    ]  # fmt: skip


def test_byte_order_mark_and_equal_times_are_accepted(tmp_path: Path) -> None:
    path = tmp_path / "times.csv"
    path.write_bytes(b"\xef\xbb\xbfframe,t_s\r\n0,1\r\n1,1\r\n2,2\r\n")
    assert [time.text for time in times_from_table(path, NAMES)] == ["1", "1", "2"]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ((), "line 1 has no column frame, t_s"),
        (("name,time", "a1,0"), "line 1 has no column frame, t_s"),
        (("frame,t_s",), "line 2 is missing"),
        (("frame,t_s", "a1,0", "a2,soon", "b,2"), "line 3: column t_s: 'soon' is not a number"),
        (("frame,t_s", "a1,0", "a2,nan", "b,2"), "line 3: column t_s: 'nan' is not a number"),
        (("frame,t_s", "a1,0", "a2", "b,2"), "line 3: column t_s: '' is not a number"),
        (("frame,t_s", "a1,0", ",1", "b,2"), "line 3: the frame is missing"),
        (("frame;t_s", "a1;0,0", "a2;0,5", "b;1,0"), "line 2: column t_s: '0,0' has a comma"),
        (("frame,t_s", "a1,0,0", "a2,0,5", "b,1,0"), "line 2 has 3 fields, the header 2"),
        (("frame,t_s", "a1,0", "a2,1e99", "b,2"), "line 3"),
        (("frame,t_s", "a1,0", "a2,1e999999999", "b,2"), "line 3"),
        (("frame,t_s", "a1,0", "a2,1"), "line 3 is the last and 'b.png' has no row"),
        (("frame,t_s", "a1,0", "a2,1", "b,2", "c,3"), "line 5: there is no frame 'c'"),
        (("frame,t_s", "0,0", "1,1", "2,2", "3,3"), "line 5: there is no frame '3'"),
        (("frame,t_s", "a1,0", "a2,1", "a1,2", "b,3"), "line 4: 'a1' is on line 2"),
        (("frame,t_s", "a1,0", "a1.png,1"), "line 3: 'a1.png' is on line 2"),
        (("frame,t_s", "a1,0", "b,1", "a2,2"), "line 4 comes before line 3"),
        (("frame,t_s", "a1,0", "a2,2", "b,1"), "line 4 comes before line 3"),
    ],
)
def test_table_with_wrong_rows_is_rejected_with_its_line(
    tmp_path: Path, lines: tuple[str, ...], message: str
) -> None:
    with pytest.raises(InputError, match=r"times.csv: .*" + message):
        times_from_table(table(tmp_path, *lines), NAMES)


def test_table_that_is_not_text_is_an_input_error(tmp_path: Path) -> None:
    path = tmp_path / "times.csv"
    with pytest.raises(InputError, match="cannot be read"):
        times_from_table(path, NAMES)
    path.write_bytes(b"\xffframe")
    with pytest.raises(InputError, match="cannot be read as text"):
        times_from_table(path, NAMES)


@given(st.text(max_size=12))
def test_any_text_is_parsed_or_rejected(text: str) -> None:
    with suppress(InputError):
        assert isinstance(parse_time(text).time_ns, int)
