"""Tactile frames of any source: reading, times, estimates and masks."""
