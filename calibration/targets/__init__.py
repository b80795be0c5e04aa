"""Calibration targets: ArUco markers, boards, printed sheets, and their detection in a picture."""
