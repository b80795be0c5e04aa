"""The UR5e over ur-rtde, in two processes: one listens, one commands; `arm.py` is the driver.

Imports the vocabulary of `drivers` alone.
"""
