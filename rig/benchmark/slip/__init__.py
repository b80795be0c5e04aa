"""`rig benchmark slip`: time, accuracy and size of a version of the estimator `slip`, beside their limits."""
