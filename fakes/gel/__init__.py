"""Rendering of a simulated DIGIT: shape of the dented gel, light, printed markers, and the image."""
