"""Calibrations: convert pixels and counts into metres and radians, each with its uncertainty.

One package or module per calibrated quantity; they use `targets` (markers and boards that cameras observe),
and below that calibration files and verdicts. Imports nothing of the rig but the shared modules of `drivers`.
"""
