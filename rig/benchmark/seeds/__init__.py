"""`rig benchmark seeds`: simulated trials of many seeds, and which of their lifts go wrong."""
