"""The costs of the first command are stated alike on all pages."""

import re
from pathlib import Path

from rig.tactile.slip.compiling import COMPILING_S

ROOT = Path(__file__).parents[3]


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
