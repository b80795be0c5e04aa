"""The one look of all pages: colours, figures that follow light and dark, and how a page is put together."""
