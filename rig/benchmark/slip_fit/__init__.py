"""`rig fit-slip`: the parameters of the estimator slip, fitted by maximum likelihood."""
