"""What cameras look at: ArUco markers, boards, printed sheets, and finding them in a picture.

Imports `calibration.verdict` alone.
"""
