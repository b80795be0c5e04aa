"""Driver of the UR5e over ur-rtde (`arm.py`), which runs in two separate processes (`processes.py`)."""
