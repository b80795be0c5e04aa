"""The experiments, written as they are done at the bench. They know interfaces only."""
