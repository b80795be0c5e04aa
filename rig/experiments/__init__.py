"""Trials, recordings and replays: the order of lifts, single attempts, and parallel processes."""
