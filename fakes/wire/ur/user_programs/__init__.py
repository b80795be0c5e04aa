"""Programs of the user's own, as far as a bench needs them; `run.py` runs one on the robot.

Imports the controller's robot and its motions.
"""
