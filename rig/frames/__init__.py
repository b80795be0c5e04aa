"""Tactile frames of any source: reading, times, estimates and masks.

Imports estimators, sessions and the slip alarm of `rig.lift`.
"""
