"""Driver of the UR5e over ur-rtde; the driver class is in `arm.py`.

The library runs in two separate processes: `state_process.py` receives the state, `control_process.py` sends
commands. This package imports only the shared modules of `drivers`.
"""
