"""Calibrations from samples on disk or from a bench: collected, solved, assessed, filed and shown.

Imports `calibration`, the protocols that collect samples, the bench and `rig.pages`.
"""
