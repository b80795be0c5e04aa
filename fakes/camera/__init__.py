"""Render the image of the simulated external camera: two markers on an object, or a calibration target."""
