"""The Python interface of `import rig`: sessions as arrays, estimators over frames, scores, calibrations.

`rig/__init__.py` lists its names and imports each on first use. It may import all packages except the
benchmarks.
"""
