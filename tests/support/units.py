"""Lengths in another unit than mm."""

import pytest

IN_MM = {"metres": 1e-3, "cm": 0.1, "inches": 1 / 25.4, "micrometres": 1e3}
"""How much smaller the number of a length is than its number of mm."""
units = pytest.mark.parametrize("unit", IN_MM)
