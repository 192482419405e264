"""Paper 002 recomputed, against the printed values and against what they are by definition."""

from __future__ import annotations

import json

import numpy as np
import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

from dqforge.machines.design import catalogue
from dqforge.optimizer.waveforms.comparison import require_phases
from dqforge.reports.papers import paper002
from dqforge.reports.papers.paper002_figures import plot_drive, plot_frames

RIGHT = {
    "balanced sine": (0.0, 1.2247, 1.2247, 1.2247, 0.0, 1.0),
    "one phase at half amplitude": (0.144, 1.031, 1.041, 1.061, 0.204, 1.061),
    "one phase missing": (0.289, 0.866, 0.913, 1.000, 0.408, 1.732),
    "trapezoid": (None, 1.491, 1.491, 1.528, 0.333, 1.042),
}


def test_table_3_1_to_three_digits_and_the_copper_losses() -> None:
    rows = {row.shape: row for row in paper002.table_3_1()}
    assert set(rows) == set(RIGHT) == set(paper002.PRINTED_TABLE_3_1)
    for shape, (*values, ratio) in RIGHT.items():
        for component, value in zip(("d", "q", "qx", "qy", "zero"), values, strict=True):
            if value is not None:
                assert rows[shape].found[component] == pytest.approx(value, abs=6e-4)
        assert rows[shape].loss_ratio == pytest.approx(ratio, abs=6e-4)


def test_printed_values_are_those_found_where_they_are_no_misprints() -> None:
    """The thesis cuts its digits: printed and recomputed differ by at most 0.011,
    but for the trapezoid.
    """
    for row in paper002.table_3_1():
        for component, printed in row.printed.items():
            if row.shape != "trapezoid" or component == "q":
                assert row.found[component] == pytest.approx(printed, abs=0.011)


def test_drive_makes_its_torque_and_its_q_current_is_constant() -> None:
    """Torque 1 N m at every angle from the phase model.

    By power, a constant dqy current makes the same copper loss.
    """
    curves = paper002.drive_curves()
    machine = require_phases(catalogue.load(paper002.DESIGN_NAME))
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


def test_figures_are_drawn() -> None:
    frames, drive = plot_frames(paper002.frame_curves()), plot_drive(paper002.drive_curves())
    assert isinstance(frames, Figure)
    assert len(frames.axes) == 20
    assert len(drive.axes) == 4


def test_command_prints_both_values_and_writes_the_figures(tmp_path: object) -> None:
    from dqforge.cli import app

    runner = CliRunner()
    shown = runner.invoke(app, ["reproduce", "002", "--figures", str(tmp_path)])
    assert shown.exit_code == 0, shown.output
    assert "1.06 / 1.061" in shown.output
    written = sorted(path.name for path in tmp_path.iterdir())  # type: ignore[attr-defined]
    assert written == ["dqforge-manifest.json", "figures-2.3-to-3.2.svg", "figures-6.4-to-6.9.svg"]
    document = json.loads(runner.invoke(app, ["reproduce", "002", "--json"]).output)
    assert document["table_3_1"][2]["loss_ratio_dqx_over_dqy"] == pytest.approx(1.7321, abs=1e-3)
