"""Facts in the pages that the code or other files state too: figures, command lines, files."""

import re

import yaml

from rig.benchmark.clips.public import SETS
from rig.benchmark.harness import markers
from support.documentation import ROOT


def test_figures_in_readme_match_the_tables() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    page = (ROOT / "docs" / "measurements.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines()]
    lifts = next(row for row in rows if row[0] == "slip" and row[1] == "-")
    assert f"MARE {lifts[3].split()[0]} degrees" in readme
    for of in SETS.values():
        begin, end = markers(f"clips {of.name}")
        section = page.partition(begin)[2].partition(end)[0]
        cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines()]
        whole, *groups = [row for row in cells if len(row) > 3 and row[0] in ("slip", "")][:3]
        clips = section.split(",")[0].strip()
        shares = [f"within 3 degrees: {whole[3]} of {whole[2]} labels on {clips}"]
        shares += [f"{row[1]} clips ({row[2]} labels): {row[3]}" for row in groups if row[0] == ""]
        assert f"| {of.data} | {'; '.join(shares)} |" in readme


def test_container_files_exist_and_services_match_the_page() -> None:
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
