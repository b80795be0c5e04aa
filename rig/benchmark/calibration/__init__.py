"""Limits on the errors of the calibrations, and their results for bad data.

Imports `calibration`, the harness and scenes of `fakes.studio`, but nothing else of `rig`.
"""
