"""Every kind of artist gives back what it was drawn from."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from figure_pages import Table, table_of
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle
from matplotlib.transforms import ScaledTranslation

from dqforge.reports.pages.figure_sheet import number_texts, read_figure
from dqforge.reports.pages.scaled import DrawnGrid, draw_filled, tick_in_unit

X = np.array([0.0, 1.0, 2.5, 4.0])
Y = np.array([3.0, -1.0, 0.25, 1e-3])


def panel() -> tuple[Figure, Axes]:
    figure = Figure()
    axes = figure.subplots()
    axes.set(xlabel="Time in s", ylabel="Torque in N m")
    return figure, axes


def read(draw: Callable[[Axes], object]) -> Table:
    figure, axes = panel()
    draw(axes)
    return table_of(read_figure(figure).csv())


def numbers(cells: list[str]) -> list[float]:
    return [float(cell) if cell else np.nan for cell in cells]


def test_curves_that_share_their_argument_share_its_column() -> None:
    def draw(axes: Axes) -> None:
        axes.plot(X, Y, label="one")
        axes.plot(X, 2.0 * Y, label="$i_d$")
        axes.plot(X + 1.0, Y, label="_late")

    table = read(draw)
    assert list(table) == [
        "Time: one, i_d [s]", "Torque: one [N m]", "Torque: i_d [N m]",
        "Time: late [s]", "Torque: late [N m]",
    ]  # fmt: skip
    assert numbers(table["Time: one, i_d [s]"]) == X.tolist()
    assert numbers(table["Torque: i_d [N m]"]) == (2.0 * Y).tolist()


def test_one_curve_needs_no_name_and_gaps_are_empty() -> None:
    table = read(lambda axes: axes.plot(X, [1.0, np.nan, 2.0, 3.0]))
    assert table == {"Time [s]": ["0", "1", "2.5", "4"], "Torque [N m]": ["1", "", "2", "3"]}


def test_decoration_is_no_data() -> None:
    def draw(axes: Axes) -> None:
        axes.axhline(1.0)
        axes.axvspan(0.0, 1.0)
        axes.plot([0.0, 1.0], [0.0, 1.0], label="_")
        axes.fill_between(X, 0.0, Y)
        axes.add_patch(Rectangle((0.0, 0.0), 1.0, 1.0))

    figure, axes = panel()
    draw(axes)
    assert read_figure(figure).headers == ()
    figure, axes = panel()
    axes.set(xticks=(), yticks=())
    axes.plot(X, Y)
    assert read_figure(figure).headers == (), "a panel without scales is a diagram"


def test_a_legend_names_by_colour_and_dashes() -> None:
    def draw(axes: Axes) -> None:
        lines = axes.plot(X, Y, color="red") + axes.plot(X, -Y, color="red", linestyle="--")
        axes.legend(lines, ["there", "back"])

    assert {"Torque: there [N m]", "Torque: back [N m]"} < set(read(draw))


def test_ticks_in_a_smaller_unit_scale_the_data() -> None:
    def draw(axes: Axes) -> None:
        axes.plot(X, 1e-3 * Y)
        axes.set_ylabel("Torque in mN m")
        tick_in_unit(axes.yaxis, 1e3)

    assert numbers(read(draw)["Torque [mN m]"]) == pytest.approx(Y.tolist(), rel=1e-12)


def test_bands_spans_and_levels() -> None:
    def draw(axes: Axes) -> None:
        axes.fill_between(X, Y - 1.0, Y + 1.0, label="spread")
        axes.axvspan(1.0, 2.0, label="_RUN")
        axes.axvspan(3.0, 4.0, label="_RUN")
        axes.axhline(7.0, label="limit")

    table = read(draw)
    assert numbers(table["Torque: spread from [N m]"]) == pytest.approx((Y - 1.0).tolist())
    assert numbers(table["Torque: spread to [N m]"]) == pytest.approx((Y + 1.0).tolist())
    assert table["Time: RUN from [s]"] == ["1", "3"]
    assert table["Time: RUN to [s]"] == ["2", "4"]
    assert table["Torque: limit [N m]"] == ["7"]


def test_steps_stairs_and_strokes() -> None:
    def draw(axes: Axes) -> None:
        axes.stairs([1.0, 5.0], [0.0, 2.0, 3.0], label="proven")
        axes.vlines(X, 0.0, Y, label="spectrum")
        axes.step(X, Y, where="post", label="held")

    table = read(draw)
    assert table["Time: proven from [s]"] == ["0", "2"]
    assert table["Time: proven to [s]"] == ["2", "3"]
    assert table["Torque: proven [N m]"] == ["1", "5"]
    assert numbers(table["Torque: spectrum [N m]"]) == Y.tolist()
    assert numbers(table["Torque: held [N m]"]) == Y.tolist()


def test_bars_have_a_row_for_each_and_parts_in_columns() -> None:
    def draw(axes: Axes) -> None:
        for y, (first, second) in enumerate(((1.0, 2.0), (3.0, 4.0))):
            axes.barh(-y, first, color="red", label="_copper")
            axes.barh(-y, second, left=first, color="blue", label="_iron")
        axes.set_yticks([0, -1], ["old", "new"])
        axes.set(xlabel="Loss in W", ylabel="")

    assert read(draw) == {
        "alternative": ["old", "new"],
        "Loss: copper [W]": ["1", "3"],
        "Loss: iron [W]": ["2", "4"],
    }


def test_bars_beside_their_place_have_its_name() -> None:
    def draw(axes: Axes) -> None:
        bars = axes.bar([0.9, 2.9], [4.0, 5.0], 0.2, label="dq")
        for bar, order in zip(bars, ("1", "3"), strict=True):
            bar.set_gid(order)
        axes.set(xlabel="Order", ylabel="A", title="Harmonics")

    assert read(draw) == {"Order [1]": ["1", "3"], "Harmonics: dq [A]": ["4", "5"]}


def test_error_bars_beside_their_place_keep_it() -> None:
    def draw(axes: Axes) -> None:
        aside = ScaledTranslation(0.1, 0.0, axes.figure.dpi_scale_trans)
        axes.errorbar(X, Y, yerr=0.5, fmt="o", label="a", transform=axes.transData + aside)

    table = read(draw)
    assert numbers(table["Time [s]"]) == X.tolist()
    assert numbers(table["Torque: a [N m]"]) == Y.tolist()
    assert numbers(table["Torque: a uncertainty [N m]"]) == pytest.approx([0.5] * 4)


def test_cells_are_rectangles_with_the_name_of_their_colour() -> None:
    def draw(axes: Axes) -> None:
        axes.add_patch(Rectangle((1.0, 2.0), 3.0, 4.0, facecolor="#102030"))
        axes.legend(handles=[Patch(color="#102030", label="dpwm1")])
        axes.set(title="Best", xlim=(0, 9), ylim=(0, 9))

    assert read(draw) == {
        "Time from [s]": ["1"],
        "Time to [s]": ["4"],
        "Torque from [N m]": ["2"],
        "Torque to [N m]": ["6"],
        "Best": ["dpwm1"],
    }


def test_cells_on_named_ticks_have_a_row_for_each_tick() -> None:
    def draw(axes: Axes) -> None:
        axes.add_patch(Rectangle((0.0, 0.0), 2.0, 1.0, label="_locks"))
        axes.set(title="Winner", xlim=(0, 2), ylim=(0, 1), xlabel="Speed in %")
        axes.set_xticks([0.5, 1.5], ["10", "50"])
        axes.set_yticks([0.5], ["-100"])

    assert read(draw) == {
        "Speed [%]": ["10", "50"],
        "Torque [N m]": ["-100", "-100"],
        "Winner": ["locks", "locks"],
    }


def test_filled_contours_give_their_grid_as_it_was_before_it_was_clipped() -> None:
    across, up = np.array([0.0, 1.0]), np.array([0.0, 2.0, 4.0])
    z = np.array([[1.0, 2.0], [3.0, np.nan], [5.0, 60.0]])

    def draw(axes: Axes) -> None:
        grid = DrawnGrid(across, up, z, "Efficiency in %")
        draw_filled(axes, grid, np.clip(np.nan_to_num(z), 0.0, 10.0))

    table = read(draw)
    assert table["Time [s]"] == ["0", "1"] * 3
    assert table["Torque [N m]"] == ["0", "0", "2", "2", "4", "4"]
    assert table["Efficiency [%]"] == ["1", "2", "3", "", "5", "60"]


def test_a_bent_grid_gives_each_of_its_points_once() -> None:
    """Torques up to another largest one for each time."""
    across, up = np.array([[0.0, 0.0], [1.0, 1.0]]), np.array([[0.0, 2.0], [0.0, 3.0]])

    def draw(axes: Axes) -> None:
        draw_filled(axes, DrawnGrid(across, up, across + up, "Efficiency in %"), across + up)

    assert read(draw) == {
        "Time [s]": ["0", "0", "1", "1"],
        "Torque [N m]": ["0", "2", "0", "3"],
        "Efficiency [%]": ["0", "2", "1", "4"],
    }


def test_filled_contours_without_their_grid_are_refused() -> None:
    figure, axes = panel()
    axes.contourf(np.ones((3, 3)).cumsum(axis=0))
    with pytest.raises(LookupError, match="draw_filled"):
        read_figure(figure)


def test_a_mesh_and_a_scatter() -> None:
    def draw(axes: Axes) -> None:
        axes.pcolormesh([0.0, 2.0, 4.0], [0.0, 1.0], [[7.0, 8.0]], label="_Loss in W")
        axes.scatter(X, Y, label="drives")

    table = read(draw)
    assert table["Loss [W]"] == ["7", "8"]
    assert numbers(table["Time: drives [s]"]) == X.tolist()
    assert numbers(table["Torque: drives [N m]"]) == Y.tolist()


@pytest.mark.parametrize("largest", [1e-7, 2.5e-3, 1.0, 283.0, 6500.0, 3e6])
def test_numbers_are_printed_to_a_hundred_thousandth_of_the_largest(largest: float) -> None:
    values = largest * np.linspace(-1.0, 1.0, 101)
    printed = np.array([float(text) for text in number_texts(values)])
    assert np.max(np.abs(printed - values)) <= 0.5e-5 * largest * (1.0 + 1e-9)
    assert max(len(text) for text in number_texts(values)) <= 14


def test_a_ripple_on_a_large_value_is_kept() -> None:
    values = 1000.0 + 1e-4 * np.sin(np.linspace(0.0, 6.0, 50))
    printed = np.array([float(text) for text in number_texts(values)])
    assert np.max(np.abs(printed - values)) < 1e-4 * np.ptp(values)


def test_small_numbers_on_a_logarithmic_scale_keep_their_digits() -> None:
    assert number_texts(np.array([1e-9, 123.4567]), log=True) == ("1e-09", "123.457")
    assert number_texts(np.array([np.inf, np.nan, -0.0])) == ("", "", "0")
