"""The Robotiq 3-Finger gripper over Modbus, TCP or RTU.

`gripper.py` is the driver, `poller.py` the thread that owns the line, `registers.py` the register map.

Imports the vocabulary of `drivers` alone.
"""
