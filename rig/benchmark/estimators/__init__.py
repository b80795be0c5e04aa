"""Run time against error: every estimator on the same lifts and under stress."""
