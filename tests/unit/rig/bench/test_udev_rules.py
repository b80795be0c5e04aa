"""The shipped udev rules: each line is one that udev reads."""

import re

from support.command_line import rig

MATCH, ASSIGN = r'[A-Z]+(?:\{[\w/]+\})?(?:==|!=)"[^"]*"', r'[A-Z]+(?:\{[\w/]+\})?(?:=|\+=|:=)"[^"]*"'
KNOWN = {"ACTION", "SUBSYSTEM", "DRIVER", "ATTR", "ATTRS", "TEST", "GROUP", "MODE", "TAG", "SYMLINK"}


def test_the_rules_are_printed_and_each_is_matches_then_assignments() -> None:
    done = rig("bench", "udev")
    assert done.returncode == 0, done.stderr
    rules = [line for line in done.stdout.splitlines() if line and not line.startswith("#")]
    assert len(rules) >= 4
    for rule in rules:
        assert re.fullmatch(rf"{MATCH}(?:, {MATCH})*(?:, {ASSIGN})+", rule), rule
        assert set(re.findall(r"(?:^|, )([A-Z]+)", rule)) <= KNOWN
    assert any('ATTRS{idVendor}=="2833"' in rule for rule in rules)
