"""Anyone's tactile frames: read, timed, and what estimators and networks say of them.

Imports estimators, sessions and the slip alarm of `rig.lift`.
"""
