"""What `import rig` offers to programs: sessions as arrays, estimators over frames, scores, calibrations.

The names stand in `rig/__init__.py`, which imports each when it is first asked for. May import everything
below the benchmarks.
"""
