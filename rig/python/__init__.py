"""The Python interface of `import rig`: sessions as arrays, estimators over frames, scores, calibrations.

`rig/__init__.py` lists its names and imports each on first use. This package may import all other packages of
`rig` except the commands and the benchmarks.
"""
