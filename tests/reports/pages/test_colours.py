"""Colours of figures stand out from the page, light and dark."""

from __future__ import annotations

import re
from importlib import resources

import pytest

from dqforge.reports.pages import figures_style
from dqforge.reports.pages.figures_style import (
    DARK,
    FAINT,
    GRID,
    INK,
    MUTED,
    PALE,
    PAPER,
    PART_COLOURS,
    SERIES,
    page_colour,
)
from dqforge.reports.pages.templating import render

CURVES = sorted({*SERIES, *PART_COLOURS.values(), PALE, INK})
TEXTS = sorted(
    {INK, MUTED, *figures_style.AXIS_COLOURS.values(), *figures_style.LOOP_COLOURS.values()}
)


def luminance(colour: str) -> float:
    """Relative luminance as WCAG 2.2 defines it."""
    parts = [int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5)]
    linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_the_measure_is_that_of_the_standard() -> None:
    assert contrast("#000000", "#ffffff") == pytest.approx(21.0)
    assert contrast("#767676", "#ffffff") == pytest.approx(4.54, abs=0.005)


@pytest.mark.parametrize("colour", CURVES)
def test_curves_and_bars_stand_out_from_both_pages(colour: str) -> None:
    assert contrast(colour, PAPER) >= 3.0
    assert contrast(DARK.get(colour, colour), DARK[PAPER]) >= 3.0


@pytest.mark.parametrize("colour", TEXTS)
def test_texts_can_be_read_on_both_pages(colour: str) -> None:
    assert contrast(colour, PAPER) >= 4.5
    assert contrast(DARK[colour], DARK[PAPER]) >= 4.5


def test_series_are_told_apart_and_the_quiet_ones_stay_quiet() -> None:
    assert len(set(SERIES)) == len(SERIES)
    assert len({DARK.get(colour, colour) for colour in SERIES}) == len(SERIES)
    for colour in (GRID, FAINT):
        assert contrast(colour, PAPER) < 2.0
        assert contrast(DARK[colour], DARK[PAPER]) < 2.5


def test_the_page_defines_every_colour_that_its_figures_ask_for() -> None:
    source = resources.files("dqforge.reports.pages") / "templates" / "style.css.j2"
    assert "figure_colours" in source.read_text(encoding="utf-8")
    style = render("pages/style.css.j2", {})
    dark = style[style.index("@media screen and (prefers-color-scheme: dark)") :]
    for light, colour in DARK.items():
        assert f"--fig-{light[1:]}: {colour}" in dark
        assert page_colour(light) == f"var(--fig-{light[1:]},{light})"
    assert page_colour("#123456") == "#123456"
    sheets = re.findall(r"--sheet: (#[0-9a-f]{6})", style)
    assert set(sheets) == {PAPER, DARK[PAPER]}, "the card of a figure is the sheet of the page"
