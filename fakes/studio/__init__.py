"""Simulated images with ground truth, for training and benchmarks; estimators get only the images."""
