"""The measurement of one lift: angles, fusion, ground truth from markers, slip onset, the stored row."""
