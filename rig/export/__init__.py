"""Sessions for other people's tools: tables, labelled images, data sets."""
