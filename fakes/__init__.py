"""A bench made of variables: one simulated world and the devices that see and move it.

`world` is the single truth, on `objects`; `gel` and `camera` draw, `devices` stand behind the
interfaces of `drivers`, `wire` behind the devices' own protocols, `studio` renders for training and
benchmarks. Imports the vocabulary of `drivers` alone: no driver, no estimator.
"""
