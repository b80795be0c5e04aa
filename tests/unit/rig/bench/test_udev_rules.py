"""The shipped udev rules: every line is valid."""

import re

from support.command_line import rig

MATCH, ASSIGN = r'[A-Z]+(?:\{[\w/]+\})?(?:==|!=)"[^"]*"', r'[A-Z]+(?:\{[\w/]+\})?(?:=|\+=|:=)"[^"]*"'
KNOWN = {"ACTION", "SUBSYSTEM", "DRIVER", "ATTR", "ATTRS", "TEST", "GROUP", "MODE", "TAG", "SYMLINK"}


def test_printed_udev_rules_have_matches_followed_by_assignments() -> None:
    done = rig("bench", "udev")
    assert done.returncode == 0, done.stderr
    rules = [line for line in done.stdout.splitlines() if line and not line.startswith("#")]
    assert len(rules) >= 4
    for rule in rules:
        assert re.fullmatch(rf"{MATCH}(?:, {MATCH})*(?:, {ASSIGN})+", rule), rule
        assert set(re.findall(r"(?:^|, )([A-Z]+)", rule)) <= KNOWN
    assert any('ATTRS{idVendor}=="2833"' in rule for rule in rules)
