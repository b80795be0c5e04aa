"""Simulated pictures with known answers, for training and benchmarks; estimators see the images alone.

Imports `fakes.gel`, `fakes.camera` and `fakes.objects`.
"""
