"""Calibrations from samples on disk or from a bench: collected, solved, judged, filed and shown."""
