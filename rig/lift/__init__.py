"""What is measured in one lift: angles, their fusion, the markers' truth, onset, and the row kept of it.

Imports estimators, sessions and metrics; it knows no device.
"""
