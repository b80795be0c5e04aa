"""Lengths in units other than mm."""

import pytest

IN_MM = {"metres": 1e-3, "cm": 0.1, "inches": 1 / 25.4, "micrometres": 1e3}
"""Length of 1 mm in each unit."""
units = pytest.mark.parametrize("unit", IN_MM)
