"""Workflows for code hosts: valid YAML, README's test command, and commands that parse."""

import re
from typing import Any

import yaml

from support.documentation import ROOT, parse

WORKFLOW = ROOT / ".github" / "workflows" / "ci.yml"
PAGE = ROOT / "docs" / "simulated.md"


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
        "pytest --long",
    )
    assert all(step in "\n".join(checks) for step in steps)
    campaign = next(line for line in lines if "rig trial" in line)
    typed = re.sub(r"^\S*rig |\|.*$", "", campaign).strip()
    assert parse(f"rig {typed}") == "trial"
    assert f"rig {typed}" in PAGE.read_text(encoding="utf-8").splitlines()


def test_workflow_for_a_lab_is_valid_and_its_commands_parse() -> None:
    block = re.search(r"^```yaml\n(.*?)^```$", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    typed = [re.sub(r" > .*", "", line) for line in commands(block[1]) if line.startswith("rig ")]
    assert [parse(line) for line in typed] == ["trial", "compare"]
