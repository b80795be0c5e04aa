"""Device interfaces of the bench, and the drivers of the real devices.

The modules at this level are shared by all packages above: interfaces, values, errors, the clock, motions,
encoded images, readers of file formats (`formats`), and the frame counters of a source. The drivers are in
`ur5e`, `robotiq_3f` and `video`; only `rig.bench` imports them by name. This package imports nothing of the
rig.
"""
