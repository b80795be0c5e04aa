"""Session folders: what is kept of every lift and pose, and how it is read back.

Imports `rig.config` alone.
"""
