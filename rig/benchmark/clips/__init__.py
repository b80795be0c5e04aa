"""`rig benchmark clips`: score estimators on labelled clips."""
