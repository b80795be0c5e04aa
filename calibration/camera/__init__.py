"""Camera model, camera files, and intrinsic calibration with its uncertainty."""
