"""The gripper's fingers: measured tables of opening over counts and of force over current.

Imports `calibration.verdict` alone.
"""
