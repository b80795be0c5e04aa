"""Manual labels: contact masks as outlines, and angles from lines drawn on a page.

Imports only `rig.frames`, `rig.sessions`, `rig.pages` and `rig.tactile` from `rig`.
"""
