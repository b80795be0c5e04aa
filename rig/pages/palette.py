"""All colours of pages and figures. A colour has the same meaning everywhere.

The hues are those of Okabe and Ito (Color Universal Design, 2008), which people with any colour vision can
distinguish. Two of them in one figure also differ in line style, shape or position.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Colour:
    """A colour with the name of its meaning, and its hex values in light and in dark mode."""

    name: str
    light: str
    dark: str

    @property
    def css(self) -> str:
        return f"var(--{self.name})"


INK = Colour("ink", "#1c2127", "#e6e9ed")
MUTED = Colour("muted", "#5b6570", "#a3adb8")
LINE = Colour("line", "#d8dde3", "#3a424c")
PAPER = Colour("paper", "#ffffff", "#14181d")
CARD = Colour("card", "#f5f7f9", "#1c2229")
PHASE = Colour("phase", "#f5eed6", "#3a3420")

ESTIMATE = Colour("estimate", "#0072b2", "#4ea8de")
TRUTH = Colour("truth", "#d55e00", "#f28e3c")
WARNING = Colour("warning", "#b07800", "#e6b345")
BAD = Colour("bad", "#b3261e", "#ff8a80")
GOOD = Colour("good", "#00734f", "#3fc79a")

FIRST = Colour("first", "#009e73", "#2fcf9f")
SECOND = Colour("second", "#92408e", "#e27fd4")

SERIES = (FIRST, SECOND, WARNING, INK)
"""Colours of curves and groups without a fixed colour, in this order."""

STATES = {
    "tracking": Colour("tracking", "#add2eb", "#1a4067"),
    "rekeyed": Colour("rekeyed", "#0746ae", "#b8d9ee"),
    "unobservable": Colour("unobservable", "#efaf2b", "#e6be4d"),
    "lost": Colour("lost", "#a20f4c", "#ca56a4"),
    "frozen": Colour("frozen", "#4b2e83", "#8f7fe0"),
    "no_contact": Colour("nocontact", "#7d828a", "#5c5c5c"),
}
"""Colour of each state of the estimator, by the names of `rig.tactile.sample.State`."""

_ALL = (
    INK, MUTED, LINE, PAPER, CARD, PHASE, ESTIMATE, TRUTH, WARNING, BAD, GOOD, FIRST, SECOND,
    *STATES.values(),
)  # fmt: skip


def variables() -> str:
    """Return the colours as CSS: dark ones on screens in dark mode, otherwise light ones, also in print."""
    light = " ".join(f"--{c.name}: {c.light};" for c in _ALL)
    dark = " ".join(f"--{c.name}: {c.dark};" for c in _ALL)
    return (
        f":root {{ color-scheme: light dark; {light} }}\n"
        f"@media screen and (prefers-color-scheme: dark) {{ :root {{ {dark} }} }}"
    )


NAME_BY_LIGHT_HEX = {c.light: c.name for c in _ALL}
"""Name of each colour, by its hex value in light mode."""
