"""Simulated images with ground truth, for training and benchmarks; estimators get only the images.

Imports `fakes.gel`, `fakes.camera` and `fakes.objects`.
"""
