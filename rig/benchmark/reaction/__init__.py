"""`rig benchmark reaction`: the same simulated lifts with and without a reaction to slip."""
