"""Colours: readable on their paper, and told apart with every kind of colour vision."""

import re
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray
from skimage.color import deltaE_ciede2000, rgb2lab

from rig.pages.figure import drawing, svg
from rig.pages.palette import (
    BAD,
    CARD,
    ESTIMATE,
    FIRST,
    GOOD,
    INK,
    MUTED,
    PAPER,
    SECOND,
    STATES,
    TRUTH,
    WARNING,
    Colour,
    variables,
)

# Machado, Oliveira and Fernandes (2009), severity 1, in linear RGB
VISION = {
    "full": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
APART = 14.0
"""CIEDE2000 between colours of areas and lines; from about 10 on they differ at a glance."""


def srgb(hex_colour: str) -> NDArray[np.float64]:
    return np.array([int(hex_colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0


def linear(rgb: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)


def seen(hex_colour: str, vision: str) -> NDArray[np.float64]:
    light = np.clip(VISION[vision] @ linear(srgb(hex_colour)), 0.0, 1.0)
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def contrast(one: str, other: str) -> float:
    """WCAG 2.2 contrast ratio."""
    bright = sorted(float(linear(srgb(c)) @ [0.2126, 0.7152, 0.0722]) for c in (one, other))
    return (bright[1] + 0.05) / (bright[0] + 0.05)


@pytest.mark.parametrize("colour", [INK, MUTED], ids=lambda c: c.name)
def test_text_is_readable_on_page_and_card(colour: Colour) -> None:
    for ground in (PAPER, CARD):
        assert contrast(colour.light, ground.light) >= 4.5
        assert contrast(colour.dark, ground.dark) >= 4.5


@pytest.mark.parametrize("colour", [ESTIMATE, TRUTH, FIRST, SECOND, GOOD, WARNING, BAD], ids=lambda c: c.name)
def test_lines_stand_out_from_the_page(colour: Colour) -> None:
    assert contrast(colour.light, PAPER.light) >= 3.0
    assert contrast(colour.dark, PAPER.dark) >= 3.0


@pytest.mark.parametrize("vision", VISION)
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_colours_that_meet_are_told_apart_with_every_colour_vision(vision: str, scheme: str) -> None:
    groups = [(ESTIMATE, TRUTH), (FIRST, SECOND), tuple(STATES.values())]
    for group in groups:
        for one, other in combinations(group, 2):
            pair = [rgb2lab(seen(getattr(c, scheme), vision).reshape(1, 1, 3)) for c in (one, other)]
            apart = float(deltaE_ciede2000(*pair)[0, 0])
            assert apart >= APART, f"{one.name} and {other.name}: {apart:.1f}"


def test_a_figure_takes_its_colours_from_the_page() -> None:
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
