"""Run time against error: every estimator on the same lifts and under stress.

Imports experiments, sessions and estimators; its own scenes are from `fakes.studio`.
"""
