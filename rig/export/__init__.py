"""Export sessions to other tools: tables, labelled images, data sets."""
