"""The experiments, written as they are done at the bench: lifts, grasps to record, calibration samples.

They know the bench by the interfaces of `drivers` alone, and who watches and who is asked by the small
ones of `observer.py` and `operator.py`. Imports the vocabulary of `drivers`: no device, nothing of the rig.
"""
