"""Common style of all pages: colours, figures for light and dark mode, templates, and the server."""
