"""`rig benchmark slip`: all figures by which a version of the estimator `slip` is judged, in one command."""
