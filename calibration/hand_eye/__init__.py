"""Estimate the pose of a camera relative to the robot from pictures of a target at known robot poses."""
