"""Measure the angle of an object with two markers on it.

Imports `calibration.camera` and `calibration.targets`.
"""
