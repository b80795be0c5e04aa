"""The terminal: escaped output, phases and progress, tables, questions, and observers of a command."""
