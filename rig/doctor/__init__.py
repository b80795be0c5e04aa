"""`rig doctor`: checks every device of a bench without moving anything, and gives advice.

Imports the bench, its configuration, and the ages of calibrations.
"""
