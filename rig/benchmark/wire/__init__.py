"""The real drivers on the bench behind wires: a lift in real time, and faults in mid-lift.

Imports experiments and the bench; knows no table of the other benchmarks.
"""
