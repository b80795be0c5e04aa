"""A tactile sensor's gel: its light at rest, its scale, and the map from its colours to surface slope."""
