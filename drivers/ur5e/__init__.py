"""Driver of the UR5e over ur-rtde; the driver class is in `arm.py`.

The library runs in two separate processes (`processes.py`): one receives the state, one sends commands. This
package imports only the shared modules of `drivers`.
"""
