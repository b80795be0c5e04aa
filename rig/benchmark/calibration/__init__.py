"""The limits that calibrations keep, and what bad data does to them."""
