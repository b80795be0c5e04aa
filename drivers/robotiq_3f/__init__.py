"""Driver of the Robotiq 3-Finger gripper over Modbus TCP or RTU.

`gripper.py` has the driver class, `modbus.py` the thread that owns the connection, `registers.py` the
registers, status and motion commands. This package imports only the shared modules of `drivers`.
"""
