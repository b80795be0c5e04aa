"""Metrics of lifts, summaries of trials, tables and listings of many sessions.

Of `rig` it imports only `rig.sessions` and `rig.tactile`.
"""
