"""The angle of an object with two markers on it.

Imports `calibration.targets`.
"""
