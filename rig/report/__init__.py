"""Pages that people look at and send: reports of trials, recordings and curves, comparisons, films."""
