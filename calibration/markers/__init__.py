"""Measure the angle of an object with two markers on it."""
