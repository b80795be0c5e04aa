"""The experiments, step by step as they are done at the bench: lifts, grasps to record, calibration samples.

They use the bench only through the interfaces of `drivers`. Observers and the operator have small interfaces
of their own in `observer.py` and `operator.py`. This package imports the shared modules of `drivers`, but no
device driver and nothing of the rig.
"""
