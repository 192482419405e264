"""The data of figures are those of the results, within the digits that are printed."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from figure_pages import Table, page_tables, table_of
from matplotlib.figure import Figure

from dqforge.machines.design import catalogue
from dqforge.machines.errors import InputError
from dqforge.optimizer.solution import Solution, solve
from dqforge.reports.capabilities import CAPABILITIES
from dqforge.reports.capability import Outcome, asked_for
from dqforge.reports.current_reference.figures import plot_errors, plot_fit, plot_mtpa
from dqforge.reports.loops.figures import plot_gains
from dqforge.reports.losses.map_figures import plot_losses
from dqforge.reports.modulation_choice.figures import plot_choice
from dqforge.reports.pages.figure_sheet import read_figure
from dqforge.reports.pages.figures_style import save, style
from dqforge.reports.pages.templating import data_file, page_figure
from dqforge.reports.report import render_report

DRIVE = "paper000-ipmsm-100kw"


@pytest.fixture(scope="module")
def solution() -> Solution:
    """The drive of paper 000 with its breakpoint given, which saves the search."""
    design = catalogue.load(DRIVE)
    return solve(replace(design, fit=replace(design.fit, breakpoints=(76.4,))))


def read(figure: Figure) -> Table:
    return table_of(read_figure(figure).csv())


def numbers(cells: list[str]) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.array([float(cell) if cell else np.nan for cell in cells])


def same(cells: list[str], values: object, largest: float | None = None) -> None:
    """Printed with at least five digits of the largest."""
    wanted = np.asarray(values, dtype=np.float64)
    most = float(np.nanmax(np.abs(wanted))) if largest is None else largest
    np.testing.assert_allclose(numbers(cells), wanted, rtol=0.0, atol=1e-5 * most)


def test_currents_of_the_plane_are_those_of_the_operating_points(solution: Solution) -> None:
    table = read(plot_mtpa(solution.design, solution.curves, solution.fit))
    chosen = solution.curves.chosen
    same(table["i_d (peak): exact MTPA [A]"], chosen.i_d)
    same(table["i_q (peak): exact MTPA [A]"], chosen.i_q)
    i_d = numbers(table["i_d (peak): torque 50 N m to torque 200 N m [A]"])
    i_q = numbers(table["i_q (peak): torque 150 N m [A]"])
    np.testing.assert_allclose(solution.design.machine.torque(i_d, i_q), 150.0, rtol=1e-3)


def test_currents_and_errors_over_torque_stand_in_the_units_of_the_axes(
    solution: Solution,
) -> None:
    table, curves = read(plot_fit(solution.design, solution.fit)), solution.fit.curves
    torque = numbers(table["Torque: i_d error [N m]"])
    error = np.interp(torque, curves.torque, 1e3 * curves.i_d)
    np.testing.assert_allclose(numbers(table["i_d error [mA]"]), error, atol=2e-3)
    assert table["Torque: breakpoint [N m]"] == ["76.4"]
    errors = read(plot_errors(solution.fit))
    largest = float(np.max(np.abs(curves.torque_error)))
    assert np.nanmax(np.abs(numbers(errors["Torque error [uN m]"]))) == pytest.approx(
        1e6 * largest, rel=1e-5
    )
    loss = numbers(errors["Extra copper loss [W]"])
    assert np.nanmax(loss) == pytest.approx(float(np.max(curves.loss)), rel=1e-5)


def test_open_loops_and_crossovers(solution: Solution) -> None:
    table = read(plot_gains(solution.gains))
    for curve in solution.gains.responses():
        name = curve.gains.loop
        same(table[f"Magnitude: {name} [dB]"], 20.0 * np.log10(curve.gain))
        same(table[f"Phase: {name} [deg]"], curve.phase)
        crossover = curve.gains.crossover / (2.0 * np.pi)
        same(table[f"Frequency: crossover of {name} [Hz]"], [crossover])


def test_every_bar_of_the_losses(solution: Solution) -> None:
    comparison = solution.losses
    assert comparison is not None
    table = read(plot_losses(solution.design, comparison))
    assert len(table["alternative"]) == comparison.usable[..., 0].size
    assert table["alternative"][0] == "130 N m, 2865 rpm: i_d = 0, SPWM"
    for part in ("copper", "conduction", "switching"):
        same(table[f"Loss: {part} [W]"], getattr(comparison.budget, part)[..., 0].ravel())


def test_every_cell_of_the_choice_of_modulators(solution: Solution) -> None:
    outcome = Outcome(solution, verified=False, simulation=None)
    found = {capability.name: result for capability, result in asked_for(CAPABILITIES, outcome)}
    choice = found["modulation_choice"]
    table = read(plot_choice(choice))
    title = "Modulator with the least loss"
    names = table[title]
    low, high, left, right = (
        numbers(table[f"{title}, {side} [{unit}]"])
        for side, unit in (
            ("Torque from", "N m"), ("Torque to", "N m"), ("Speed from", "rpm"), ("Speed to", "rpm")
        )
    )  # fmt: skip
    best = choice.best.modulation.reshape(choice.torque.size, -1)
    rpm = choice.omega_m * 30.0 / math.pi
    checked = 0
    for i, torque in enumerate(choice.torque.tolist()):
        for j, speed in enumerate(rpm.tolist()):
            here = (low < torque) & (torque < high) & (left < speed) & (speed < right)
            if int(best[i, j]) < 0:
                assert not here.any() or names[int(np.flatnonzero(here)[0])] == "limits not kept"
                continue
            told = choice.best.modulations[int(best[i, j])]
            assert names[int(np.flatnonzero(here)[0])] == told
            checked += 1
    assert checked > 100
    assert numbers(table["Mean loss over the map [W]"])[0] == pytest.approx(
        choice.best_mean, rel=1e-5
    )


UNIT = re.compile(r" \[[^\]]+\]$")
NUMBERED = re.compile(r" \(\d+\)( \[|$)")


def complete(table: Table) -> None:
    """Columns with values, with units where they are numbers, and with names of their own."""
    assert table
    for head, cells in table.items():
        assert cells, head
        assert not NUMBERED.search(head), head
        assert head.isascii(), head
        if not UNIT.search(head):
            assert not all(re.fullmatch(r"-?[\d.]+", cell) for cell in cells if cell), head
        assert not any(cell in {"nan", "inf", "-inf"} for cell in cells), head


@pytest.mark.slow
@pytest.mark.parametrize("name", catalogue.names())
def test_every_figure_of_every_shipped_drive_has_its_data_with_units(name: str) -> None:
    solved = solve(catalogue.load(name))
    page = render_report(solved, None)
    tables = page_tables(page)
    assert len(tables) == page.count('<figure class="drawing"') > 3
    for table in tables.values():
        complete(table)
    assert len(page.encode()) < 1_000_000


def test_the_page_has_a_link_with_the_data_of_each_figure(solution: Solution) -> None:
    figure = plot_gains(solution.gains)
    page = page_figure(figure, "drive-loops")
    (table,) = page_tables(f'download="{page.data.name}" href="{page.data.link}"').values()
    assert table == read(figure)
    complete(table)
    assert page.data.name == "drive-loops.csv"
    assert not re.search(r"[\s\"'<>]", page.data.link.replace(" ", ""))
    assert page_figure(plot_gains(solution.gains), "drive-loops") == page


def test_a_link_is_written_in_the_shorter_way() -> None:
    assert ";base64," not in data_file("a.csv", "Torque [N m]\n1\n2\n").link
    assert ";base64," in data_file("a.csv", "\u03c9" * 100).link


def test_the_same_data_are_written_into_a_file(solution: Solution, tmp_path: Path) -> None:
    figure = plot_mtpa(solution.design, solution.curves)
    save(figure, tmp_path / "mtpa.csv")
    assert (tmp_path / "mtpa.csv").read_bytes() == read_figure(figure).csv().encode()
    with pytest.raises(InputError, match=r"its data as \.csv; 'mtpa.txt' has the suffix"):
        save(figure, tmp_path / "mtpa.txt")


def test_frames_map_data_to_the_place_where_they_are_drawn(solution: Solution) -> None:
    """The transform of the library itself, linear and logarithmic."""
    figure = plot_gains(solution.gains)
    page_figure(figure, "loops")
    sheet = read_figure(figure)
    width, height = 72.0 * figure.get_size_inches()
    for panel, frame in zip(sheet.panels, sheet.frames(), strict=True):
        x0, y0, x1, y1 = frame["box"]
        ends = [(axis["from"], axis["to"], "log" in axis) for axis in (frame["x"], frame["y"])]
        for share in (0.0, 0.3, 1.0):
            place = [
                low * (high / low) ** share if log else low + share * (high - low)
                for low, high, log in ends
            ]
            with style():
                across, up = figure.transFigure.inverted().transform(
                    panel.axes.transData.transform(place)
                )
            assert across * width == pytest.approx(x0 + share * (x1 - x0), abs=0.02)
            assert (1.0 - up) * height == pytest.approx(y1 - share * (y1 - y0), abs=0.02)


DRAW: dict[str, Callable[[Solution], Figure]] = {
    "mtpa": lambda s: plot_mtpa(s.design, s.curves, s.fit),
    "fit": lambda s: plot_fit(s.design, s.fit),
    "errors": lambda s: plot_errors(s.fit),
}


@pytest.mark.parametrize("name", DRAW)
def test_reading_a_figure_leaves_it_as_it_was(solution: Solution, name: str) -> None:
    figure = DRAW[name](solution)
    before = read_figure(figure).csv()
    page_figure(figure, name)
    assert read_figure(figure).csv() == before
    complete(table_of(before))
