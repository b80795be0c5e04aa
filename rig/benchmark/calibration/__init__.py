"""Limits on the errors of the calibrations, and their results for bad data."""
