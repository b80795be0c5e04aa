"""Numbers that turn pixels and counts into metres and radians, with their uncertainty.

A package for each thing calibrated, over `targets` (what cameras look at) and, below, verdicts and
files. Imports the vocabulary of `drivers` alone.
"""
