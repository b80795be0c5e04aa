"""Calibrations: what turns pixels and counts into metres and radians, each with its uncertainty.

A package or module for each thing that is calibrated; below them `targets` (what cameras look at), then files
and verdicts. Imports nothing of the rig but the vocabulary of `drivers`.
"""
