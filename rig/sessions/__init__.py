"""Session folders: writing and reading the data of every lift and pose.

Imports `rig.config` alone.
"""
