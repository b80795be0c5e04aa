"""The UR5e over ur-rtde; `arm.py` is the driver.

The library runs in two processes of its own: `state_process.py` listens, `control_process.py` commands.

Imports the vocabulary of `drivers` alone.
"""
