"""Pages and films for people: reports of trials, recordings and curves, comparisons, films."""
