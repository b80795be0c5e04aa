"""Estimate the rotation of an object from tactile frames.

`contact` detects the contact. `slip` is the rig's own estimator, `paper` has the paper's methods, and `peers`
the methods that it is compared with. `estimators` makes each by its name. Of the other packages, only
`drivers` is imported.
"""
