"""The paper's methods, mended and as published: contact, long axis, window.

Imports `rig.tactile.contact`.
"""
