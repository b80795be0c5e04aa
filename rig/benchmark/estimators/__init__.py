"""`rig benchmark estimators`: measure run time and error of every estimator, on lifts and disturbed clips.

Imports experiments, sessions and estimators; the scenes of the disturbed clips are from `fakes.studio`.
"""
