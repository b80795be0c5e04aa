"""Calibrations from samples on disk or from a bench: collected, solved, assessed, filed and shown."""
