"""Create a real or simulated bench from a bench file, and the operator who answers its questions.

This is the only package that imports concrete devices by name. It imports `rig.config`, drivers and fakes.
"""
