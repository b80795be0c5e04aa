"""A tactile sensor's gel: its light at rest, its scale, and how its colours tell the slope of its surface."""
