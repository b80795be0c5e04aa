"""The estimator `slip`: gradient, keyframes, alignment, filter, sigma.

`estimator.py` puts the stages in order. Imports `rig.tactile.contact`.
"""
