"""The limits of the calibrations, and their results for bad data.

Imports `calibration`, the harness and its own scenes (`fakes.studio`), nothing else of `rig`.
"""
