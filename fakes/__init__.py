"""The simulated bench: one simulated world, and the devices that measure and move it.

`world` holds the true state, with the models of `objects`. `gel` and `camera` render images. `devices`
implement the interfaces of `drivers`; `wire` serves the devices over their wire protocols. `studio` renders
images for training and benchmarks. Of `drivers`, only the common types are imported, and no driver or
estimator.
"""
