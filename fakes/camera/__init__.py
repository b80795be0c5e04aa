"""What the simulated external camera sees: two markers on an object, or a calibration target.

Imports `fakes.world`.
"""
