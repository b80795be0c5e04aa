"""Driver of the Robotiq 3-Finger gripper over Modbus TCP or RTU (`gripper.py`)."""
