"""Sessions for other people's tools: tables, labelled images, data sets.

Imports sessions, results and labels.
"""
