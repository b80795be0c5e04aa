"""Driver of the Robotiq 3-Finger gripper over Modbus TCP or RTU.

`gripper.py` has the driver class, `poller.py` the thread that owns the connection, `registers.py` the
register map. This package imports only the shared modules of `drivers`.
"""
