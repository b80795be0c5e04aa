"""How long it takes to list many sessions and to open a long one: made sessions of the sizes of real ones.

Imports sessions, results, and the measured numbers of benchmarks.
"""
