"""`rig benchmark estimators`: measure run time and error of every estimator, on lifts and disturbed clips."""
