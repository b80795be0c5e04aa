"""The slip rig: command line, assembly, perception, records and results."""
