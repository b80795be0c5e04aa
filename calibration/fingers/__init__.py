"""The gripper's fingers: measured tables of opening over counts.

Imports `calibration.verdict` alone.
"""
