"""A simulated 3-Finger gripper behind Modbus, over TCP or a pseudo-terminal; `server.py` serves it."""
