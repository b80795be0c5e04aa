"""What the bench's hardware can do (interfaces, values, errors, the clock), and the real devices doing it.

Everything above speaks in the terms of this package's modules; the devices' packages (`ur5e`,
`robotiq_3f`, `video`) are named by `rig.bench` alone. Imports nothing of the rig.
"""
