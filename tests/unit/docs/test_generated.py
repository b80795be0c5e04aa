"""Facts in the pages that the code or other files state too: messages, figures, files."""

import ast
import re
from pathlib import Path

import yaml

from support.documentation import ROOT, script


def quoted_messages() -> list[tuple[str, str]]:
    """Messages that pages quote in tables of their own: page, and message with `...` for what differs."""
    found = []
    for page in sorted((ROOT / "docs").glob("*.md")):
        for table in re.findall(r"^\| message \|.*?(?=\n\n|\Z)", page.read_text(), re.MULTILINE | re.DOTALL):
            found += [(page.name, text) for text in re.findall(r"^\| `([^`]+)` \|", table, re.MULTILINE)]
    return found


def code_texts() -> set[str]:
    """Every text in the code, with `...` for each value in an f-string."""
    paths = [
        path
        for folder in ("drivers", "calibration", "protocols", "rig")
        for path in (ROOT / folder).rglob("*.py")
    ]
    nodes = [node for path in paths for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))]
    plain = {node.value for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str)}
    return plain | {
        "".join(part.value if isinstance(part, ast.Constant) else "..." for part in node.values)
        for node in nodes
        if isinstance(node, ast.JoinedStr)
    }


def test_messages_that_pages_quote_are_those_of_the_code() -> None:
    quoted = quoted_messages()
    assert len(quoted) >= 5
    texts = code_texts()
    for page, message in quoted:
        wanted = re.compile(".*".join(map(re.escape, message.split("..."))), re.DOTALL)
        assert any(wanted.search(text) for text in texts), f"{page}: {message}: the rig says no such thing"


def test_readme_says_what_the_tables_say() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    page = (ROOT / "docs" / "estimators.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines()]
    lifts = next(row for row in rows if row[0] == "slip" and row[1] == "-")
    at = next(i for i, row in enumerate(rows) if row[:2] == ["slip", "all"])
    everything, developed, held_back = (rows[at + i][3] for i in range(3))
    assert f"MARE {lifts[3].split()[0]} degrees" in readme
    shares = f"{everything} ({developed} on clips it was developed on, {held_back} on the others)"
    assert re.sub("(?<=[0-9])%", " %", shares) in readme


def test_the_lines_that_are_not_run_say_why() -> None:
    lines = script("try_it").command_lines(long=False)
    assert sum(not line.why_not for line in lines) > 30
    assert all("needs" in line.why_not or "--long" in line.why_not for line in lines if line.why_not)
    moving = [line for line in lines if "--bench my_bench.toml" in line.text and " objects " not in line.text]
    assert len(moving) > 5
    assert all(line.why_not for line in moving)


def test_the_image_copies_what_is_there_and_the_services_are_as_the_page_says() -> None:
    copied = re.findall(r"^COPY (.*) \S+$", (ROOT / "Dockerfile").read_text(), re.MULTILINE)
    files = " ".join(copied).split()
    assert all((ROOT / name).exists() for name in files)
    kept = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    assert kept == set(files)
    services = yaml.safe_load((ROOT / "compose.yaml").read_text())["services"]
    assert services["simulated"]["command"] == ["trial", "--lifts", "5"]
    bench = services["bench"]
    assert (bench["network_mode"], bench["tty"], bench["stdin_open"]) == ("host", True, True)
    assert bench["environment"]["XDG_STATE_HOME"].startswith("/bench/")


def test_the_citation_is_of_the_paper() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert {"cff-version", "message", "title", "authors"} <= citation.keys()
    paper = citation["preferred-citation"]
    assert [author["family-names"] for author in paper["authors"]] == ["Castaño-Amorós", "Gil"]
    assert paper["year"] == 2023


def test_pages_are_not_long() -> None:
    long = {p.name: n for p in (ROOT / "docs").glob("*.md") if (n := len(_lines(p))) > 160}
    assert long == {}
    assert len(_lines(ROOT / "README.md")) < 80


def _lines(page: Path) -> list[str]:
    return page.read_text(encoding="utf-8").splitlines()
