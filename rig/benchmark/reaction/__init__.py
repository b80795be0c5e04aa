"""The benefit of reactions to slip: the same simulated lifts with and without them."""
