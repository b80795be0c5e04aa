"""Metrics of lifts, summaries of trials, tables and listings of many sessions.

Imports only `rig.sessions`.
"""
