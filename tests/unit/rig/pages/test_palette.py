"""Colours are readable on their background and distinguishable with any colour vision."""

import re

import numpy as np
import pytest
from numpy.typing import NDArray

from rig.pages import palette
from rig.pages.figure import drawing, svg
from rig.pages.palette import CARD, ESTIMATE, INK, MUTED, PAPER, Colour, variables


def srgb(hex_colour: str) -> NDArray[np.float64]:
    return np.array([int(hex_colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0


def linear(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def contrast(one: str, other: str) -> float:
    """WCAG 2.2 contrast ratio."""
    bright = sorted(float(linear(srgb(c)) @ [0.2126, 0.7152, 0.0722]) for c in (one, other))
    return (bright[1] + 0.05) / (bright[0] + 0.05)


@pytest.mark.parametrize("colour", [INK, MUTED], ids=lambda c: c.name)
def test_text_is_readable_on_page_and_card(colour: Colour) -> None:
    for ground in (PAPER, CARD):
        assert contrast(colour.light, ground.light) >= 4.5
        assert contrast(colour.dark, ground.dark) >= 4.5


@pytest.mark.parametrize("name", ["ESTIMATE", "TRUTH", "FIRST", "SECOND", "GOOD", "WARNING", "BAD"])
def test_lines_stand_out_from_the_page(name: str) -> None:
    colour: Colour = getattr(palette, name)
    assert contrast(colour.light, PAPER.light) >= 3.0
    assert contrast(colour.dark, PAPER.dark) >= 3.0


def test_figure_uses_the_colours_of_the_page() -> None:
    with drawing(200) as figure:
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], color=ESTIMATE.light)
        axes.set_xlabel("time, s")
        drawn = str(svg(figure, 'a "name" & more'))
    used = set(re.findall(r"var\((--\w+)\)", drawn))
    assert "--estimate" in used
    assert "--ink" in used
    assert all(f"{name}:" in variables() for name in used)
    assert not re.findall(r"#[0-9a-f]{6}\b", drawn)
    assert ">time, s<" in drawn
    assert 'aria-label="a &#34;name&#34; &amp; more"' in drawn
