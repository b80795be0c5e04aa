"""README and docs: links, anchors and pictures exist; the index has each page. See `.ci/site.py`, too."""

import re
from pathlib import Path

from support.documentation import PAGES, ROOT, without_code

LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
DOCS = ROOT / "docs"


def anchors(page: Path) -> set[str]:
    """Names of a page's headings, as a code host and the site give them."""
    headings = re.findall(r"^#+ (.+)$", without_code(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def targets(page: Path) -> list[str]:
    """What a page links to, but other people's sites."""
    found = LINK.findall(without_code(page))
    return [target for target in found if not target.startswith(("http://", "https://", "mailto:"))]


def test_links_anchors_and_pictures_exist() -> None:
    for page in PAGES:
        for target in targets(page):
            name, _, anchor = target.partition("#")
            file = (page.parent / name).resolve() if name else page
            assert file.is_file(), f"{page.name}: {target}: no such file"
            assert file.is_relative_to(ROOT), f"{page.name}: {target} lies outside"
            assert not anchor or anchor in anchors(file), f"{page.name}: {target}: no such heading"


def test_index_links_every_page() -> None:
    named = {Path(target).name for target in targets(DOCS / "index.md")}
    assert named == {page.name for page in DOCS.glob("*.md")} - {"index.md"}


def test_docs_have_at_most_25_pages() -> None:
    assert len(list(DOCS.glob("*.md"))) <= 25, "write a section of an existing page"
