"""Simulated pictures with known answers, for training and benchmarks; estimators see only the images.

Imports `fakes.gel`, `fakes.camera` and `fakes.objects`.
"""
