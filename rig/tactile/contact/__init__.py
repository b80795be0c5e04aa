"""Where the object touches the gel: gate, classical mask, networks, and frames without contact.

Imports nothing else of `rig.tactile`.
"""
