"""Device interfaces of the bench, and the drivers of the real devices.

The modules at this level are shared by all packages above. The drivers are in `ur5e`, `robotiq_3f` and
`video`; only `rig.bench` imports them by name. This package imports nothing of the rig.
"""
