"""The limits that calibrations keep, and what bad data does to them.

Imports `calibration` and its own scenes (`fakes.studio`), nothing else of `rig`.
"""
