"""Vectors as plain numbers. Here by themselves: the arm's processes need these, and start without numpy."""

Vector3 = tuple[float, float, float]
Vector6 = tuple[float, float, float, float, float, float]
