"""Contact masks as labels: outlines, and the file formats that other tools read.

Of `rig` it imports the sessions alone.
"""
