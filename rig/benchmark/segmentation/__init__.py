"""Contact masks: networks and the classical mask against labels, and their run time."""
