"""Links, places and facts in README and docs, and the workflows for code hosts."""

import re
import shlex
import subprocess
from dataclasses import fields
from importlib import import_module
from pathlib import Path, PurePosixPath
from typing import Any

import pytest
import yaml

import rig.sessions.about
import rig.sessions.recorder
from rig.benchmark.clips.public import SETS
from rig.benchmark.harness import markers
from rig.benchmark.wire.safety import EVENTS
from rig.results.limits import LIFT_FIGURES, SESSION_FIGURES
from rig.results.table import ERRORS
from rig.sessions.records import IF_REACTING, IN_CSV, Lift, LiftOutcome, lift_columns
from rig.sessions.table_files import unit_of
from rig.tactile.slip.compiling import COMPILING_S
from support.documentation import PAGES, ROOT, parse, script, without_code

LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
DOCS, CONTRIBUTING = ROOT / "docs", ROOT / "CONTRIBUTING.md"


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


def tracked() -> list[str]:
    """Paths of the files of the repository; skips the test without git."""
    found = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if found.returncode:
        pytest.skip("no git, or not a clone")
    return found.stdout.splitlines()


def test_top_level_has_only_what_contributing_lists() -> None:
    text = CONTRIBUTING.read_text(encoding="utf-8")
    listed = text[text.index("The top level holds") : text.index("nothing else.")]
    assert {path.partition("/")[0] for path in tracked()} == set(re.findall("`([^`]+)`", listed))


def test_files_named_in_pages_exist_and_contain_the_names_given_with_them() -> None:
    """As `rig/lift/result.py`, and `NAME` in `FILE` or `NAME` (`FILE`)."""
    files = tracked()
    folders = {str(folder) for file in files for folder in PurePosixPath(file).parents}
    packages = {file.partition("/")[0] for file in files if file.endswith(".py")}

    def matching(name: str) -> list[str]:
        return [file for file in files if file == name or file.endswith(f"/{name}")]

    for page in (*PAGES, CONTRIBUTING):
        text = without_code(page)
        for name in re.findall(r"`([\w./-]+)`", text):
            path = name.rstrip("/")
            is_path = "/" in path and path.partition("/")[0] in packages
            if is_path or path.endswith(".py"):
                assert path in folders or matching(path), f"{page.name}: there is no {name}"
        for name, file in re.findall(r"`([A-Za-z_][\w.]*)`\s(?:in\s|\()`([\w/.-]+\.py)`", text):
            last = name.rpartition(".")[2]
            sources = [(ROOT / path).read_text(encoding="utf-8") for path in matching(file)]
            assert any(re.search(rf"\b{last}\b", source) for source in sources), (
                f"{page.name}: {name} in {file}"
            )


def test_lines_that_run_a_program_of_tools_parse() -> None:
    pages = (*PAGES, ROOT / "rig" / "models" / "README.md", *(ROOT / "tools").glob("*.py"))
    lines = [
        line
        for page in pages
        for line in re.findall(
            r"python tools/(\w+)\.py ([^`\n]*--out \S+?)(?=[`\s])", page.read_text("utf-8")
        )
    ]
    assert len(lines) >= 12
    for program, arguments in lines:
        import_module(program).options_parser().parse_args(shlex.split(arguments))


def test_index_links_every_page_of_at_most_25() -> None:
    pages = {page.name for page in DOCS.glob("*.md")} - {"index.md"}
    assert {Path(target).name for target in targets(DOCS / "index.md")} == pages
    assert len(pages) <= 25, "write a section of an existing page"


def test_page_of_constants_is_generated_from_the_source() -> None:
    generator = script("list_constants")
    assert generator.PAGE.read_text(encoding="utf-8") == generator.make_page(), "run docs/list_constants.py"


def test_figures_in_readme_match_the_tables() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    page = (DOCS / "measurements.md").read_text(encoding="utf-8")
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines()]
    lifts = next(row for row in rows if row[0] == "slip" and row[1] == "-")
    assert f"MARE {lifts[4].split()[0]} degrees" in readme
    for of in SETS.values():
        begin, end = markers(f"clips {of.name}")
        section = page.partition(begin)[2].partition(end)[0]
        cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in section.splitlines()]
        whole, *groups = [row for row in cells if len(row) > 3 and row[0] in ("slip", "")][:3]
        clips = section.split(",")[0].strip()
        shares = [f"within 3 degrees: {whole[3]} of {whole[2]} labels on {clips}"]
        shares += [f"{row[1]} clips ({row[2]} labels): {row[3]}" for row in groups if row[0] == ""]
        assert f"| {of.data} | {'; '.join(shares)} |" in readme


def test_table_of_events_has_every_event_of_the_safety_benchmark() -> None:
    begin, end = markers("safety")
    section = (DOCS / "measurements.md").read_text(encoding="utf-8").partition(begin)[2].partition(end)[0]
    header, _, *rows = [line.strip("|").split(" | ") for line in section.splitlines() if line.startswith("|")]
    assert header[-1].strip() == "next lift"
    assert [row[0].strip() for row in rows] == [event.name for event in EVENTS]


def test_times_of_a_frame_match_the_table_of_real_clips() -> None:
    begin, end = markers("clips octopi")
    section = (DOCS / "measurements.md").read_text(encoding="utf-8").partition(begin)[2].partition(end)[0]
    processor = re.search(r"family \d+ model \d+", section)
    row = next(line.split("|") for line in section.splitlines() if line.startswith("| slip | all |"))
    (median, _, p99), multiple = row[-3].strip().split(", "), row[-2].strip()
    assert processor is not None
    text = " ".join((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert f"took {median} ms (median) and {p99} ms (99 %) through `rig.estimator`" in text
    assert processor[0] in text
    assert f"{multiple} times as long as OpenCV's `findTransformECC`" in text


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


def costs(page: str) -> dict[str, str]:
    text = " ".join((ROOT / page).read_text().split())
    found = {
        "lifts": re.search(r"(\d+ to \d+ s) (?:for the 45 lifts|on two idle cores)", text),
        "session": re.search(r"(?:session|idle cores, and) (\d\.\d\d GB)", text),
        "compiling": re.search(r"compil\w+ the estimator(?: once)?, about (\d+) s", text),
    }
    return {name: match[1] for name, match in found.items() if match is not None}


def test_costs_of_the_first_command_agree() -> None:
    readme = costs("README.md")
    assert readme["compiling"] == str(COMPILING_S)
    assert costs("docs/first_lift_simulated.md") == readme


FORMATS = (DOCS / "formats.md").read_text(encoding="utf-8")


def section(heading: str) -> str:
    """The text below a heading, to the next one."""
    return re.split(r"^#+ ", FORMATS.split(f"### {heading}\n")[1], flags=re.MULTILINE)[0]


def first_cells(text: str) -> set[str]:
    """What stands between backticks in the first column of the tables of a text."""
    return {
        name
        for row in re.findall(r"^\|([^|]*)\|", text, re.MULTILINE)
        for name in re.findall("`([^`]+)`", row)
    }


KEYS = section("The keys of a lift")


def test_keys_and_outcomes_of_a_lift_are_named() -> None:
    keys = {field.name for field in fields(Lift) if "doc" in field.metadata}
    assert keys | {outcome.value for outcome in LiftOutcome} == first_cells(KEYS)
    assert set(ERRORS) <= keys


def test_columns_of_the_table_of_lifts_are_named() -> None:
    after = " ".join(KEYS.split("`lifts.csv` has")[1].split())
    columns = {column.name for column in lift_columns() if column.tables in (IN_CSV, IF_REACTING)}
    errors = {name for name in columns if name.startswith("re_") and not name.startswith("re_b_")}
    assert columns - errors <= set(re.findall("`([^`]+)`", after))


def test_every_figure_that_may_have_a_limit_is_listed_with_its_unit() -> None:
    limits = (DOCS / "report.md").read_text().split("## Limits")[1].split("\n## ")[0]
    rows = re.findall(r"^\| (`[^|]*) \|([^|]*)\|", limits, re.MULTILINE)
    listed = {name: unit.strip() for names, unit in rows for name in re.findall("`([^`]+)`", names)}
    assert listed == {name: unit_of(name) or "" for name in (*LIFT_FIGURES, *SESSION_FIGURES)}


def test_topics_of_a_recording_are_named() -> None:
    topics = {
        value + ("SERIAL" if name.endswith("_PREFIX") else "")
        for module in (rig.sessions.recorder, rig.sessions.about)
        for name, value in vars(module).items()
        if name.endswith(("_TOPIC", "_PREFIX"))
    }
    assert len(topics) >= 12
    assert topics == first_cells(section("The recording of a lift"))


WORKFLOW = ROOT / ".github" / "workflows" / "ci.yml"
SIMULATED = DOCS / "simulated.md"


def commands(text: str) -> list[str]:
    """Every line that the jobs of a workflow run; each step either runs something or uses an action."""
    workflow: dict[Any, Any] = yaml.safe_load(text)
    steps = [step for job in workflow["jobs"].values() for step in job["steps"]]
    assert all(("run" in step) != ("uses" in step) for step in steps)
    return [line for step in steps for line in step.get("run", "").splitlines()]


def test_workflow_runs_readmes_test_command_and_a_campaign() -> None:
    lines = commands(WORKFLOW.read_text(encoding="utf-8"))
    assert ".ci/run" in lines
    plain, *checks = (ROOT / ".ci" / "run").read_text().splitlines()[4:]
    assert f"    {plain}" in (ROOT / "README.md").read_text().splitlines()
    steps = (
        "ruff check",
        "ruff format --check",
        "lint-imports",
        "codespell",
        "site.py",
        "wheel.py",
        "other_processor.py -m pytest",
        "pytest --all",
    )
    assert all(step in "\n".join(checks) for step in steps)
    campaign = next(line for line in lines if "rig trial" in line)
    typed = re.sub(r"^\S*rig |\|.*$", "", campaign).strip()
    assert parse(f"rig {typed}") == "trial"
    assert f"rig {typed}" in SIMULATED.read_text(encoding="utf-8").splitlines()


def test_workflow_for_a_lab_is_valid_and_its_commands_parse() -> None:
    block = re.search(
        r"^```yaml\n(.*?)^```$", SIMULATED.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL
    )
    typed = [re.sub(r" > .*", "", line) for line in commands(block[1]) if line.startswith("rig ")]
    assert [parse(line) for line in typed] == ["trial", "compare"]
