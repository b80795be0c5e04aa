"""Trials, recordings and replays: the order of lifts, single attempts, and parallel processes.

Imports the bench, the measurement of a lift, sessions and results, but no command and no page.
"""
