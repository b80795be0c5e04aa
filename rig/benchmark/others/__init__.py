"""Foreign clients on the simulated devices, and foreign readers on a session's files; each may be missing.

Nothing of others comes with the rig. Imports the benchmarks' tables, exports and the fakes' process.
"""
