"""Paper 002 recomputed, against the printed values and against what they are by definition."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from hidden_compilers import hide_compilers
from matplotlib.figure import Figure
from typer.testing import CliRunner

from dqforge.reports.papers import paper002_bench_currents
from dqforge.reports.papers import paper002_compensation as back_emf_components
from dqforge.reports.papers.paper002_bench_currents import plot_currents, plot_frames, plot_machine
from dqforge.reports.papers.paper002_compensation import plot_structures, plot_terms
from dqforge.reports.papers.paper002_tables import FIGURES, Reproduction, reproduce_paper

RIGHT = {
    "balanced sine": (0.0, 1.2247, 1.2247, 1.2247, 0.0, 1.0),
    "one phase at half amplitude": (0.144, 1.031, 1.041, 1.061, 0.204, 1.061),
    "one phase missing": (0.289, 0.866, 0.913, 1.000, 0.408, 1.732),
    "trapezoid": (None, 1.491, 1.491, 1.528, 0.333, 1.042),
}


def _least_currents(shares: tuple[float, ...], *, balanced: bool) -> np.ndarray:
    """Currents of the phases for a torque of one, each angle a constrained least-norm problem."""
    theta = 2.0 * np.pi * np.arange(180) / 180
    found = np.empty((3, theta.size))
    for place, angle in enumerate(theta):
        lag = angle - 2.0 * np.pi / 3.0 * np.arange(3)
        flux = np.sin(lag) + sum(
            share * np.sin(order * lag) for order, share in zip((3, 5, 7), shares, strict=True)
        )
        rows, wanted = [flux], [1.0]
        if balanced:
            rows.append(np.ones(3))
            wanted.append(0.0)
        found[:, place] = np.linalg.lstsq(np.array(rows), np.array(wanted), rcond=None)[0]
    return found


@pytest.mark.parametrize(
    "shares", [(0.12, 0.03, 0.01), (0.12, -0.03, 0.01), (0.2, 0.02, -0.04), (0.05, 0.06, -0.06)]
)
def test_the_orders_by_which_both_currents_differ_are_those_of_least_norm(
    shares: tuple[float, ...],
) -> None:
    x, y = (_least_currents(shares, balanced=balanced) for balanced in (True, False))
    theta = 2.0 * np.pi * np.arange(180) / 180
    apart = [abs(np.sum((y - x)[0] * np.exp(-1j * order * theta))) for order in range(14)]
    lines, ratio = paper002_bench_currents.apart_of(np.array([shares]))
    assert lines[0] / np.max(lines) == pytest.approx(np.array(apart) / np.max(apart), abs=1e-4)
    assert ratio[0] == pytest.approx(np.sum(x**2) / np.sum(y**2), rel=1e-4)


def test_the_words_of_the_thesis_leave_fifth_and_seventh_against_the_fundamental() -> None:
    spoken = paper002_bench_currents.spoken_harmonics(paper002_bench_currents.bench_curves())
    assert spoken.shipped == pytest.approx((0.12, 0.03, 0.01))
    assert spoken.opposed
    assert not spoken.shipped_agrees
    assert spoken.turned_agrees
    assert 0.2 < spoken.agreeing / spoken.sets < 0.5
    # dqy never has more copper loss than dqx.
    assert 1.0 <= spoken.loss_least < spoken.loss_largest < 1.2


def test_table_3_1_to_three_digits_and_the_copper_losses() -> None:
    rows = {row.shape: row for row in back_emf_components.table_3_1()}
    assert set(rows) == set(RIGHT) == set(back_emf_components.PRINTED_TABLE_3_1)
    for shape, (*values, ratio) in RIGHT.items():
        for component, value in zip(("d", "q", "qx", "qy", "zero"), values, strict=True):
            if value is not None:
                assert rows[shape].found[component] == pytest.approx(value, abs=6e-4)
        assert rows[shape].loss_ratio == pytest.approx(ratio, abs=6e-4)


def test_printed_values_are_those_found_where_they_are_no_misprints() -> None:
    """The thesis cuts its digits: printed and recomputed differ by at most 0.011,
    but for the trapezoid.
    """
    for row in back_emf_components.table_3_1():
        for component, printed in row.printed.items():
            if row.shape != "trapezoid" or component == "q":
                assert row.found[component] == pytest.approx(printed, abs=0.011)


def test_drive_makes_its_torque_and_its_q_current_is_constant() -> None:
    """Torque 1 N m at every angle from the phase model.

    By power, a constant dqy current makes the same copper loss.
    """
    curves = paper002_bench_currents.bench_curves()
    machine = paper002_bench_currents.bench_machine()
    third = machine.angles // 3
    for current in curves.currents:
        phases = np.stack([current, np.roll(current, third), np.roll(current, -third)])
        np.testing.assert_allclose(machine.torque(phases), 1.0, atol=1e-9)
    # i = a_y i_qy along F: the loss is R i_qy^2 mean(a_y^2), a_y = sqrt(3/2) / |F|.
    phases = np.stack([np.roll(curves.currents[1], shift) for shift in (0, third, -third)])
    square = curves.i_qy**2 * np.mean(curves.angles.a_y**2)
    assert float(machine.copper_loss(phases)) == pytest.approx(machine.r_s * square, rel=1e-9)
    assert curves.harmonics[1, 3] > 0.1 * curves.harmonics[1, 1]
    assert curves.harmonics[0, 3] < 1e-9


@pytest.fixture(scope="module")
def found() -> Reproduction:
    """Without a compiler: all but the closed loops."""
    with pytest.MonkeyPatch.context() as patch:
        hide_compilers(patch)
        return reproduce_paper()


def test_figures_are_drawn(found: Reproduction) -> None:
    drawn = [
        plot_frames(back_emf_components.frame_curves()),
        plot_structures(),
        plot_terms(found.terms),
        plot_machine(found.curves),
        plot_currents(found.curves),
    ]
    assert all(isinstance(figure, Figure) for figure in drawn)
    assert [len(figure.axes) for figure in drawn] == [20, 3, 6, 6, 7]


def test_every_figure_of_the_chapters_is_accounted_for() -> None:
    """4.1 to 4.3 and 6.1 to 6.18, each once, the photographs with what they are."""
    numbers = [number for entry in FIGURES for number in entry.numbers.split(", ")]
    assert numbers == [f"4.{k}" for k in range(1, 4)] + [f"6.{k}" for k in range(1, 19)]
    assert [entry.numbers for entry in FIGURES if "photograph" in entry.lacks] == ["6.1", "6.8"]


def test_shipped_drive_has_what_the_thesis_states(found: Reproduction) -> None:
    for condition in found.conditions:
        assert condition.used == pytest.approx(condition.printed, rel=1e-3), condition.name


def test_numbers_of_the_curves(found: Reproduction) -> None:
    """Figures 6.9 to 6.16: identities to rounding, and the sizes that the inferred data give."""
    values = {(row.figure, row.quantity): row for row in found.curve_figures}
    for row in found.curve_figures:
        if row.expected is not None:
            assert row.found == pytest.approx(row.expected, abs=1e-9), row.quantity
    sizes = {
        ("6.9", "i_qy, least"): 2.031,
        ("6.10", "i_qx, least"): 1.977,
        ("6.10", "i_qx, largest"): 2.031,
        ("6.11", "i_alpha, r.m.s."): 1.275,
        ("6.11", "i_alpha, peak"): 1.757,
        ("6.13", "i_0, r.m.s."): 0.211,
        ("6.13", "i_0, peak"): 0.290,
        ("6.13", "i_0, order 3"): 0.298,
        ("6.13", "i_0, order 9"): 0.008,
        ("6.16", "i_a, r.m.s."): 1.048,
        ("6.16", "i_a, peak"): 1.339,
    }
    for key, size in sizes.items():
        assert values[key].found == pytest.approx(size, abs=6e-4), key


def test_orders_that_tell_dqx_from_dqy(found: Reproduction) -> None:
    """The thesis names 1, 3 and 7; with the inferred harmonics 5 and 7 tell about as much."""
    assert found.telling[:2] == (3, 1)
    assert set(found.telling[2:]) == {5, 7}
    gap = np.abs(found.curves.harmonics[1] - found.curves.harmonics[0])
    assert gap[7] == pytest.approx(gap[5], rel=0.1)


def test_copper_losses_of_dqx_over_dqy_in_closed_form(found: Reproduction) -> None:
    """1 over the mean square of what bears the torque: exact values, and that of the drive."""
    ratios = {row.shape: row.loss_ratio for row in found.rows}
    assert ratios["balanced sine"] == pytest.approx(1.0, abs=1e-12)
    assert ratios["one phase at half amplitude"] == pytest.approx(1.0607, abs=1e-4)
    assert ratios["one phase missing"] == pytest.approx(np.sqrt(3.0), abs=1e-9)
    assert ratios["trapezoid"] == pytest.approx(1.0419, abs=1e-4)
    assert found.curves.loss_ratio == pytest.approx(1.0137, abs=5e-5)


@pytest.mark.slow
def test_command_prints_both_values_and_writes_the_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from dqforge.cli import app

    hide_compilers(monkeypatch)
    runner = CliRunner()
    shown = runner.invoke(app, ["reproduce", "002", "--figures", str(tmp_path)])
    assert shown.exit_code == 0, shown.output
    assert "1.06 / 1.061" in shown.output
    assert "Missing: no C compiler found" in shown.output
    written = sorted(path.name for path in tmp_path.iterdir())
    assert written == [
        "dqforge-manifest.json",
        "figure-4.3-terms.svg",
        "figures-2.3-to-3.2.svg",
        "figures-4.1-to-4.3.svg",
        "figures-6.2-to-6.7.svg",
        "figures-6.9-to-6.16.svg",
    ]
    document = json.loads(runner.invoke(app, ["reproduce", "002", "--json"]).output)
    assert document["table_3_1"][2]["loss_ratio_dqx_over_dqy"] == pytest.approx(1.7321, abs=1e-3)
    assert document["closed_loops"] is None
    assert "no C compiler" in document["closed_loops_left_out"]


@pytest.mark.slow
def test_command_shows_both_circuits_side_by_side(tmp_path: Path) -> None:
    from dqforge.cli import app

    runner = CliRunner()
    shown = runner.invoke(app, ["reproduce", "002", "--figures", str(tmp_path)])
    assert shown.exit_code == 0, shown.output
    assert "why Figure 5.4 cannot carry it" in shown.output
    written = {path.name for path in tmp_path.iterdir()}
    assert {"figures-6.9-to-6.16-loops.svg", "figures-6.17-to-6.18.svg"} < written
    for path in tmp_path.glob("*.svg"):
        assert "_{" not in path.read_text(encoding="utf-8"), path.name
    document = json.loads(runner.invoke(app, ["reproduce", "002", "--json"]).output)
    circuits = [run["circuit"] for run in document["closed_loops"]]
    assert circuits.count("diode-neutral") == circuits.count("four-leg") == 3
    assert document["closed_loops_left_out"] is None
    for run in document["closed_loops"]:
        assert len(run["theta_rad"]) == len(run["i_alphabeta0_A"][0]) == 400


def _named(paper: str) -> set[str]:
    """Numbers of the figures that the page has a row for."""
    page = (Path(__file__).parents[3] / "docs/project/papers.md").read_text("utf-8")
    table = page.split(f"| `reproduce {paper}` |")[1].split("\n\n")[0]
    found: set[str] = set()
    for row in re.findall(r"^\| (Figures? [^|]*)\|", table, re.MULTILINE):
        for first, last in re.findall(r"(\d+\.?\d*)(?: to (\d+\.?\d*))?", row):
            chapter, _, low = first.rpartition(".")
            high = (last or first).rpartition(".")[2]
            found |= {f"{chapter}.{k}".strip(".") for k in range(int(low), int(high) + 1)}
    return found


def test_every_figure_has_a_row() -> None:
    assert _named("000") == {"3", "4", "5"}
    assert _named("001") == {f"8.{k}" for k in range(1, 34)}
    numbers = {number for row in FIGURES for number in row.numbers.split(", ")}
    assert numbers <= _named("002")
    assert {f"6.{k}" for k in range(1, 19)} | {"4.1", "4.2", "4.3"} <= _named("002")


_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?![\w.]*\w)")


@pytest.mark.slow
@pytest.mark.parametrize("paper", ["000", "001", "002"])
def test_numbers_of_the_rows_are_those_of_the_command(paper: str) -> None:
    """Every number of "here" is printed by the command, with its digits, or in thousandths (s for
    ms); rows about another command are left to its page.
    """
    from dqforge.cli import app

    page = (Path(__file__).parents[3] / "docs/project/papers.md").read_text("utf-8")
    rows = page.split(f"| `reproduce {paper}` |")[1].split("\n\n")[0].splitlines()[2:]
    output = CliRunner().invoke(app, ["reproduce", paper]).output.replace("\u2212", "-")
    printed = np.abs([float(text) for text in _NUMBER.findall(output)])
    missing = []
    for row in rows:
        name, *_, here = (cell.strip() for cell in row[1:-1].split("|"))
        for text in _NUMBER.findall("" if "`control." in here else here.replace("\u2212", "-")):
            near = 0.51 * 10.0 ** -len(text.partition(".")[2])
            value = abs(float(text))
            if not any((np.abs(printed * scale - value) <= near).any() for scale in (1.0, 1e3)):
                missing.append(f"{name}: {text}")
    assert not missing
