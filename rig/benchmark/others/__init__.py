"""What others made, clients, data and solvers, run against what was made here; each skips where it is not.

Nothing of others is kept here: packages are imported where they are installed, data is read from a folder of
clones. Imports the benchmarks' tables, calibration, exports and the fakes' process.
"""
