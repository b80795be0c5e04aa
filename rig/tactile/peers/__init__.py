"""Methods from the literature for comparison: image alignment, printed dots, networks."""
