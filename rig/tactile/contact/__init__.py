"""Detect where the object touches the gel, by image processing or a network; make backgrounds.

Of `rig.tactile` it imports only the interface of samples.
"""
