"""The paper's Tables III and IV on the same simulated lifts.

Imports `rig.benchmark.estimators` and the networks' names of `rig.benchmark.segmentation`.
"""
