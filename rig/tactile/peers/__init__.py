"""Other people's methods, to compare with: image alignments, printed dots, networks.

Imports `rig.tactile.contact`.
"""
