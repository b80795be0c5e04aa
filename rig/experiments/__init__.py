"""Trials, recordings and replays: which lift comes next, one attempt at it, and processes side by side.

Imports the bench, a lift's measurement, sessions and results; no command and no page.
"""
