"""A second renderer of gel pictures: estimators on lifts that another simulator drew.

It shares no code and no number with the simulated bench, so that what both get wrong in the same way is
less. Its figures are simulated all the same. It judges; only the standard deviation of `slip` is fitted to
lifts of it, of other numbers (`rig.benchmark.sigma`).
"""
