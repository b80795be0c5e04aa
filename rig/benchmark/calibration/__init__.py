"""The limits of the calibrations, and their results for bad data."""
