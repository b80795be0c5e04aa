"""Readers of files from people and other tools: one per format, with size limits checked before decoding.

Imports only errors. Input that a reader rejects raises `FormatError`, whatever the bytes are.
"""

from drivers.formats.csv_table import (
    MAX_TIME_S,
    CsvTable,
    number_in,
    parse_csv,
    parse_number,
    parse_time_ns,
    parse_whole,
    read_csv,
    read_csv_rows,
    time_ns_in,
    whole_in,
)
from drivers.formats.picture import MOST_PIXELS, jpeg_header, may_hold_several, picture_count, picture_flaw
from drivers.formats.structured import check_numbers, parse_json, parse_toml, read_json, read_toml, read_yaml
from drivers.formats.text import (
    in_number_order,
    read_beginning,
    read_bounded,
    read_text,
    reason,
    shown,
    without_passwords,
    write_whole,
)
from drivers.formats.unpacking import MOST_NETWORK, check_onnx, check_pieces, check_unpacked, check_zip
