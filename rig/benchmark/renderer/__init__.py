"""A second renderer of gel images, to test estimators on lifts of another simulator.

It shares no code and no constants with the simulated bench, so that both are unlikely to have the same
errors. Its figures are simulated as well. Nothing is fitted to its lifts, with one exception: the standard
deviation of `slip` is fitted to lifts with other numbers (`rig.benchmark.slip_fit`).
"""
