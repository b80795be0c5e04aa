"""A camera's model, files and intrinsics, and how well they are known.

Imports `calibration.targets`.
"""
