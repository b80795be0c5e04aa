"""Every colour of every picture, once: the same colour means the same thing on all of them.

The hues are those of Okabe and Ito (Color Universal Design, 2008), told apart with any colour
vision; where two meet in one picture, line style, shape or place differs too.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Colour:
    """A colour named by its meaning: hex values on white paper and on a dark screen."""

    name: str
    light: str
    dark: str

    @property
    def css(self) -> str:
        """Reference to it in a page's styles."""
        return f"var(--{self.name})"


INK = Colour("ink", "#1c2127", "#e6e9ed")
MUTED = Colour("muted", "#5b6570", "#a3adb8")
LINE = Colour("line", "#d8dde3", "#3a424c")
PAPER = Colour("paper", "#ffffff", "#14181d")
CARD = Colour("card", "#f5f7f9", "#1c2229")
PHASE = Colour("phase", "#e8edf2", "#262e38")

ESTIMATE = Colour("estimate", "#0072b2", "#4ea8de")
TRUTH = Colour("truth", "#d55e00", "#f28e3c")
WARNING = Colour("warning", "#b07800", "#e6b345")
BAD = Colour("bad", "#b3261e", "#ff8a80")
GOOD = Colour("good", "#00734f", "#3fc79a")

FIRST = Colour("first", "#009e73", "#2fcf9f")
SECOND = Colour("second", "#92408e", "#e27fd4")

SERIES = (FIRST, SECOND, WARNING, INK)
"""Curves and groups that have no colour of their own, in order."""

STATES = {
    "tracking": Colour("tracking", "#add2eb", "#1a4067"),
    "rekeyed": Colour("rekeyed", "#0746ae", "#b8d9ee"),
    "unobservable": Colour("unobservable", "#efaf2b", "#e6be4d"),
    "lost": Colour("lost", "#a20f4c", "#ca56a4"),
    "no_contact": Colour("nocontact", "#7d828a", "#5c5c5c"),
}
"""What the estimator claims about a frame, by the names of `rig.tactile.sample.State`."""

_ALL = (
    INK, MUTED, LINE, PAPER, CARD, PHASE, ESTIMATE, TRUTH, WARNING, BAD, GOOD, FIRST, SECOND,
    *STATES.values(),
)  # fmt: skip


def variables() -> str:
    """Return the colours as CSS: light ones, dark ones where the reader's system is dark, light on paper."""
    light = " ".join(f"--{c.name}: {c.light};" for c in _ALL)
    dark = " ".join(f"--{c.name}: {c.dark};" for c in _ALL)
    return (
        f":root {{ color-scheme: light dark; {light} }}\n"
        f"@media screen and (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}"
    )


def by_light_hex() -> dict[str, str]:
    """Return the name of each colour, by its hex on white paper."""
    return {c.light: c.name for c in _ALL}
