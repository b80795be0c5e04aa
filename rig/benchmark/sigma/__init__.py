"""`rig benchmark sigma`: the standard deviation that the estimator slip reports, fitted to known errors."""
