"""The pages of this folder as a site: `sphinx-build -W docs build/site` (extra `docs`). Needs no network."""

import re

project = "The slip rig"
copyright = "the slip rig developers, MIT licence"
extensions = ["myst_parser", "sphinx.ext.autodoc"]
html_theme = "furo"
html_title = "The slip rig"
html_copy_source = False
html_show_sphinx = False
html_show_sourcelink = False
default_role = "code"  # in docstrings, single backticks mark code
smartquotes = False  # messages stand as the rig prints them
# Headings are anchors, named as a code host names them.
myst_heading_anchors = 3
pygments_style = "friendly"
pygments_dark_style = "native"


def contents(text: str) -> str:
    """Return the site's contents: a table for each heading of the index, of the pages it links to."""
    tables = []
    for section in text.split("\n## ")[1:]:
        pages = re.findall(r"^- \[[^\]]+\]\((\w+)\.md\)", section, re.MULTILINE)
        caption = section.splitlines()[0]
        tables.append("\n".join(["```{toctree}", ":hidden:", f":caption: {caption}", *pages, "```"]))
    return "\n\n".join(tables)


def _add_contents(app: object, name: str, source: list[str]) -> None:
    del app
    if name == "index":
        source[0] += "\n\n" + contents(source[0])


def setup(app: object) -> None:
    """Add the contents to the index, where a code host would show them as a block of code."""
    app.connect("source-read", _add_contents)  # type: ignore[attr-defined]
