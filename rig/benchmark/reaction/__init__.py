"""What reactions to slip are worth: the same simulated lifts, with and without."""
