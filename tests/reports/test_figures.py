"""Figures: labelled with units, well-formed, the same bytes twice, and refused
where the format is unknown.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

from dqforge.machines.design import catalogue
from dqforge.machines.errors import InputError
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.current_reference.figures import plot_errors, plot_fit, plot_mtpa
from dqforge.reports.loops.figures import plot_gains
from dqforge.reports.losses.map_figures import plot_losses
from dqforge.reports.pages.figures_style import prefixed, save, thinned, to_svg

SVG = "{http://www.w3.org/2000/svg}"
Draw = Callable[[Solution], Figure]


def _losses(solution: Solution) -> Figure:
    assert solution.losses is not None
    return plot_losses(solution.design, solution.losses)


FIGURES: dict[str, tuple[Draw, tuple[str, ...]]] = {
    "mtpa": (
        lambda s: plot_mtpa(s.design, s.curves, s.fit),
        (
            "i_d in A (peak)",
            "i_q in A (peak)",
            "current limit 283 A (peak)",
            "firmware reference",
            "150 N m",
        ),
    ),
    "fit": (
        lambda s: plot_fit(s.design, s.fit),
        ("Torque in N m", "Current in A (peak)", "i_d error in mA", "i_q error in mA"),
    ),
    "errors": (
        lambda s: plot_errors(s.fit),
        (
            "Torque in N m",
            "Torque error in \u00b5N m",
            "ppb of largest torque",
            "Extra copper loss in W",
        ),
    ),
    "loops": (
        lambda s: plot_gains(s.gains),
        (
            "Time in ms",
            "Response per unit step",
            "Magnitude in dB",
            "Phase in degrees",
            "Frequency in Hz",
            "i_d: 71.0",
        ),
    ),
    "losses": (
        _losses,
        ("Loss in W", "copper loss", "i_d = 0, SPWM", "MTPA, DDT-GDPWM", "\u25c0 least"),
    ),
}


@pytest.fixture(scope="module")
def solution() -> Solution:
    """The drive of paper 000 with its breakpoint given, which saves the search."""
    design = catalogue.load("paper000-ipmsm-100kw")
    return solve(replace(design, fit=replace(design.fit, breakpoints=(76.4,))))


def svg_texts(svg: str) -> list[str]:
    """Texts of an SVG with its subscripts as ``i_d``."""
    texts = []
    for element in ET.fromstring(svg).iter(f"{SVG}text"):
        parts = [element.text or ""]
        for span in element:
            subscript = span.get("font-size") is not None
            parts.append(f"_{span.text or ''}" if subscript else span.text or "")
        texts.append("".join(parts).replace("\u00a0", " "))
    return texts


@pytest.mark.parametrize("name", FIGURES)
def test_svg_has_its_labels_with_units(solution: Solution, name: str) -> None:
    draw, labels = FIGURES[name]
    text = "\n".join(svg_texts(to_svg(draw(solution))))
    for label in labels:
        assert label in text


@pytest.mark.thinned
@pytest.mark.parametrize("name", FIGURES)
def test_svg_is_small_and_asks_for_nothing(solution: Solution, name: str) -> None:
    svg = to_svg(FIGURES[name][0](solution))
    assert len(svg) < 60_000
    assert svg.startswith("<svg ")
    assert "http" not in svg.replace('xmlns="http://www.w3.org/2000/svg"', "")
    assert "<style" not in svg, "a style element would hold for the whole page"
    assert "<metadata" not in svg


@pytest.mark.thinned
@pytest.mark.parametrize("name", FIGURES)
def test_identifiers_are_those_of_the_figure_and_resolve(solution: Solution, name: str) -> None:
    svg = to_svg(FIGURES[name][0](solution))
    identifiers = re.findall(r'\bid="([^"]*)"', svg)
    references = re.findall(r'url\(#([^)]*)\)|href="#([^"]*)"', svg)
    assert len(set(identifiers)) == len(identifiers)
    assert all(found.startswith(f"{name}-") for found in identifiers)
    assert {a or b for a, b in references} <= set(identifiers)


@pytest.mark.slow
def test_the_same_result_gives_the_same_bytes(solution: Solution) -> None:
    for draw, _ in FIGURES.values():
        assert to_svg(draw(solution)) == to_svg(draw(solution))


def test_figures_ignore_and_keep_the_users_settings(solution: Solution) -> None:
    plain = to_svg(plot_fit(solution.design, solution.fit))
    with mpl.rc_context({"axes.facecolor": "red", "font.size": 20.0, "lines.linewidth": 9.0}):
        before = dict(mpl.rcParams)
        assert to_svg(plot_fit(solution.design, solution.fit)) == plain
        assert dict(mpl.rcParams) == before


@pytest.mark.thinned
@pytest.mark.parametrize("suffix", [".svg", ".png", ".pdf"])
def test_saved_files_are_the_same_bytes_twice(
    solution: Solution, tmp_path: Path, suffix: str
) -> None:
    first, second = tmp_path / f"first{suffix}", tmp_path / f"second{suffix.upper()}"
    for path in (first, second):
        save(plot_mtpa(solution.design, solution.curves), path)
    assert first.read_bytes() == second.read_bytes()
    magic = {".svg": b"<?xml", ".png": b"\x89PNG", ".pdf": b"%PDF"}[suffix]
    assert first.read_bytes().startswith(magic)
    assert b"matplotlib" not in first.read_bytes().lower().replace(b"matplotlib.", b"")
    assert sorted(tmp_path.iterdir()) == sorted([first, second])


def test_saving_an_svg_leaves_the_figure_as_it_was(solution: Solution) -> None:
    figure = plot_mtpa(solution.design, solution.curves)
    to_svg(figure)
    assert figure.axes[0].get_xlabel() == "$i_d$ in A (peak)"


@pytest.mark.parametrize("name", ["figure.jpg", "figure"])
def test_an_unknown_suffix_is_refused_in_one_line(
    solution: Solution, tmp_path: Path, name: str
) -> None:
    with pytest.raises(InputError, match=r"\.svg, \.png or \.pdf, its data as \.csv") as caught:
        save(plot_mtpa(solution.design, solution.curves), tmp_path / name)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_mtpa_without_fit_has_no_reference(solution: Solution) -> None:
    assert "firmware reference" not in svg_texts(
        to_svg(plot_mtpa(solution.design, solution.curves))
    )


def test_alternatives_that_cannot_be_used_say_why(solution: Solution) -> None:
    comparison = solution.losses
    assert comparison is not None
    linear = comparison.budget.linear.copy()
    linear[0, 0, 0] = False
    stable = comparison.budget.steady.copy()
    stable[0, 1, 0] = False
    total = comparison.budget.total.copy()
    total[0, 1, 0] = np.nan
    budget = replace(comparison.budget, linear=linear, steady=stable, total=total)
    texts = svg_texts(to_svg(plot_losses(solution.design, replace(comparison, budget=budget))))
    assert "voltage beyond the linear range" in texts
    assert "junction temperature runs away" in texts


def test_thinning_keeps_extremes_and_ends() -> None:
    argument = np.linspace(0.0, 1.0, 5001)
    value = np.sin(300.0 * argument)
    value[1234] = 7.0
    thin_argument, thin_value = thinned(argument, value, bins=50)
    assert thin_argument.size <= 102
    assert thin_value.max() == 7.0
    assert thin_value.min() == value.min()
    assert (thin_argument[0], thin_argument[-1]) == (0.0, 1.0)
    assert np.all(np.diff(thin_argument) > 0.0)


@pytest.mark.parametrize(
    ("largest", "unit"),
    [(283.0, "A"), (0.02, "mA"), (3e-6, "\u00b5A"), (2e-9, "nA"), (1e-20, "pA"), (0.0, "A")],
)
def test_units_fit_the_size_of_the_values(largest: float, unit: str) -> None:
    assert prefixed(largest, "A")[1] == unit
