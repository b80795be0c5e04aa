"""Readers of files from people and other tools: one per format, with size limits checked before decoding.

Imports only errors. Input that a reader rejects raises `FormatError`, whatever the bytes are.
"""

from drivers.formats.csv_table import CsvTable, parse_csv, read_csv, read_csv_rows
from drivers.formats.names import in_number_order
from drivers.formats.numbers import (
    MAX_TIME_S,
    number_in,
    parse_number,
    parse_time_ns,
    parse_whole,
    time_ns_in,
    whole_in,
)
from drivers.formats.onnx_sizes import check_onnx
from drivers.formats.picture import MOST_PIXELS, jpeg_header, picture_count, picture_flaw
from drivers.formats.structured import check_numbers, parse_json, parse_toml, read_json, read_toml, read_yaml
from drivers.formats.text import read_bounded, read_text, reason, shown, without_passwords, write_whole
from drivers.formats.unpacking import MOST_NETWORK, check_pieces, check_unpacked, check_zip

__all__ = [
    "MAX_TIME_S",
    "MOST_NETWORK",
    "MOST_PIXELS",
    "CsvTable",
    "check_numbers",
    "check_onnx",
    "check_pieces",
    "check_unpacked",
    "check_zip",
    "in_number_order",
    "jpeg_header",
    "number_in",
    "parse_csv",
    "parse_json",
    "parse_number",
    "parse_time_ns",
    "parse_toml",
    "parse_whole",
    "picture_count",
    "picture_flaw",
    "read_bounded",
    "read_csv",
    "read_csv_rows",
    "read_json",
    "read_text",
    "read_toml",
    "read_yaml",
    "reason",
    "shown",
    "time_ns_in",
    "whole_in",
    "without_passwords",
    "write_whole",
]
