"""`rig doctor`: looks at every device of a bench without moving anything, and says what to do.

Imports the bench, its configuration, and the ages of calibrations.
"""
