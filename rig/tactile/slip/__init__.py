"""The estimator `slip`: gradient, keyframes, alignment, filter, sigma.

`estimator.py` runs the stages in order. Imports `rig.tactile.contact`.
"""
