"""`rig benchmark clips`: estimators on labelled clips.

May import `rig.frames`, `rig.tactile`, `rig.pages` and what other benchmarks share.
"""
