"""README and docs: links, anchors and pictures are there, each page has its place, and the site builds."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import rig
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


@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_links_anchors_and_pictures_exist(page: Path) -> None:
    for target in targets(page):
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        assert file.is_file(), f"{page.name}: {target}: no such file"
        assert file.is_relative_to(ROOT), f"{page.name}: {target} lies outside"
        if anchor:
            assert anchor in anchors(file), f"{page.name}: {target}: no such heading"


def test_index_links_every_page() -> None:
    named = {Path(target).name for target in targets(DOCS / "index.md")}
    assert named == {page.name for page in DOCS.glob("*.md")} - {"index.md"}


def test_docs_have_at_most_25_pages() -> None:
    assert len(list(DOCS.glob("*.md"))) <= 25, "write a section of an existing page"


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site as documented; a warning is an error."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "sphinx", "-W", "-q", "-b", "html", str(DOCS), str(folder)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return folder


@pytest.mark.slow
def test_the_site_documents_every_name_of_the_python_interface(site: Path) -> None:
    page = (site / "python.html").read_text(encoding="utf-8")
    assert all(f'id="rig.{name}"' in page for name in rig.__all__)


@pytest.mark.slow
def test_the_site_has_every_page_and_needs_no_network(site: Path) -> None:
    page = (site / "index.html").read_text(encoding="utf-8")
    assert page.count("toctree-l1") >= len(PAGES) - 2
    fetched = re.findall(r'<(?:script|link|img)[^>]*(?:src|href)="(https?://[^"]+)"', page)
    assert fetched == [], "the site needs the network"
