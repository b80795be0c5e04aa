"""The Robotiq 3-Finger gripper over Modbus; `gripper.py` is the driver, `registers.py` its register map.

Imports the vocabulary of `drivers` alone.
"""
