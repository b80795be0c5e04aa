"""Foreign clients on the simulated devices, and foreign readers on a session's files; each may be missing.

The rig contains no third-party program. Imports the benchmarks' tables, the exports and the fakes' process.
"""
