"""Order of numbered files: numbers in their names are compared as numbers, not as text."""

import re
from collections.abc import Iterable
from decimal import Decimal
from pathlib import Path

_POINT = r"(?<![0-9])(?<![0-9]\.)[0-9]+\.{}(?:e[+-][0-9]{{1,2}})?(?!\.?[0-9])"
"""A decimal number that is no part of a longer chain, such as a date, 2026.11.26."""
_FRACTION = re.compile(_POINT.format("([0-9]+)"))
_DECIMAL = re.compile(f"((?:^-)?(?:{_POINT.format('[0-9]+')}|[0-9]+(?:e[+-][0-9]{{1,2}})?))")
_WHOLE = re.compile("((?:^-)?[0-9]+)")


def in_number_order(files: Iterable[Path]) -> list[Path]:
    """Return files sorted by name: 2.png before 10.png, 0.1337035.png before 0.867143.png.

    Digits with one point are a decimal number, as in names that are times, if all have equally many digits
    after the point, or none ends with a 0, which programs leave out. Otherwise they are two integers, as in
    1.9.png and 1.10.png, frames of lift 1.
    """
    files = list(files)
    fractions = [fraction for file in files for fraction in _FRACTION.findall(file.stem)]
    one_width = len({len(fraction) for fraction in fractions}) < 2
    no_end_zero = not any(fraction.endswith("0") and len(fraction) > 1 for fraction in fractions)
    number = _DECIMAL if one_width or no_end_zero else _WHOLE

    def key(file: Path) -> tuple[list[str | Decimal], str]:
        parts = number.split(file.stem)  # text and numbers take turns
        return [Decimal(part) if place % 2 else part for place, part in enumerate(parts)], file.name

    return sorted(files, key=key)
