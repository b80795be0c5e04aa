"""Training of segmentation networks (extra `train`): data, networks, the loop, export to ONNX.

Imports `rig.labels`, `rig.sessions` and the simulated bench; renders its own scenes with `fakes.studio`.
"""
