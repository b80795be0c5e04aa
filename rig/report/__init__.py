"""Pages that people look at and send: reports of trials, recordings and curves, comparisons, films.

Imports replays (`rig.experiments`), results, sessions, a lift's measurement and `rig.pages`.
"""
