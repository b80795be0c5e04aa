"""`rig benchmark clips`: score estimators on labelled clips.

It may import `rig.frames`, `rig.tactile`, `rig.pages` and the shared modules of the benchmarks.
"""
