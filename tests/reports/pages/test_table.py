"""The numbers in the terminal's tables: their units, and what is written
where there is no number.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from drives import IPM, MOSFET, make_design

from dqforge.machines.design.settings import LoadPoint, LossSettings
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.losses.solve import solve_losses
from dqforge.optimizer.operating_points.solve import solve_curves
from dqforge.optimizer.solution import solve
from dqforge.reports.loops.tables import gains_tables
from dqforge.reports.losses.tables import losses_tables
from dqforge.reports.operating_points.tables import mtpa_tables
from dqforge.reports.pages.table import Table
from dqforge.reports.summary import run_tables


def column(table: Table, heading: str) -> list[str]:
    return [row[table.columns.index(heading)] for row in table.rows]


def test_operating_points_in_amperes_and_per_unit() -> None:
    """Bases psi/(2 dl) = 216.74 A and 3/4 p psi i_base = 68.206 N m.

    The optimum is T = i_q (2 - i_d) per unit.
    """
    design = make_design()
    table = mtpa_tables(design, solve_curves(design, 100.0))[0]
    i_base = 0.1049 / (2.0 * 242e-6)
    for torque, i_d, i_q, current in zip(
        *(column(table, name) for name in ("torque N m", "i_d A", "i_q A", "|i| A")), strict=True
    ):
        assert float(current) == pytest.approx(math.hypot(float(i_d), float(i_q)), rel=1e-3)
        produced = 6.0 * (0.1049 - 242e-6 * float(i_d)) * float(i_q)
        assert produced == pytest.approx(float(torque), rel=2e-3)
    for i_d, per_unit in zip(column(table, "i_d A"), column(table, "i_d p.u."), strict=True):
        assert float(per_unit) == pytest.approx(float(i_d) / i_base, rel=1e-3, abs=1e-9)
    for torque, i_d, i_q in zip(
        *(column(table, name) for name in ("torque p.u.", "i_d p.u.", "i_q p.u.")), strict=True
    ):
        assert float(torque) == pytest.approx(float(i_q) * (2.0 - float(i_d)), rel=2e-3)


def test_gains_and_margins() -> None:
    """Bandwidth w = 6283 rad/s at 100 kHz with 1.5 samples of delay: 90 deg
    less 6283 rad/s times 15 us.

    The loop is nearly k/(z (z - 1)) with k = w t_s; z^2 - z + k has its roots on
    the unit circle at k = 1.
    """
    design = make_design()
    table, forms, observer = gains_tables(design, solve_gains(design))
    assert table.title == "test drive: gains, sampled every 10 us"
    for heading, expected in (
        ("crossover Hz", 1000.0),
        ("phase margin deg", 84.6),
        ("delay margin us", 235.0),
    ):
        for cell in column(table, heading)[:2]:
            assert float(cell) == pytest.approx(expected, rel=5e-3)
    assert [float(cell) for cell in column(table, "gain margin dB")[:2]] == pytest.approx(
        [24.04] * 2, abs=0.1
    )
    q_axis = solve_gains(design).i_q
    kp, ki_ts, q0, q1 = (
        float(column(forms, name)[1])
        for name in forms.columns[1:6]
        if not name.startswith("series")
    )
    assert (q0, q1) == pytest.approx((kp + ki_ts, -kp), rel=1e-5)
    assert column(forms, "series: T_i")[1] == f"{1e3 * q_axis.kp / q_axis.ki:.5g} ms"
    load, resistance = (
        float(re.findall(r"(?:by|high by) (-?[\d.e-]+) rpm", note)[0])
        for note in observer.notes[1:]
    )
    # T_L/(J g) and -0.3 R g/(g p psi) at g = 500/s, J = 0.05 kg m^2; 30/pi rpm for each rad/s.
    assert load == pytest.approx(1.0 / (0.05 * 500.0) * 30.0 / math.pi, rel=5e-3)
    assert resistance == pytest.approx(-0.3 * 2e-3 / (4 * 0.1049) * 30.0 / math.pi, rel=5e-3)


def test_losses_add_up_and_the_title_has_the_speed_in_rpm() -> None:
    design = replace(make_design(), losses=LossSettings((LoadPoint(130.0, 300.0),)))
    comparison = solve_losses(design)
    assert comparison is not None
    table = losses_tables(design, comparison)[0]
    assert table.title.endswith("losses at 130 N m, 2864.8 rpm")
    copper, conduction, switching, total, junction, saving = (
        np.array([float(cell) for cell in column(table, name)])
        for name in (
            "copper W",
            "conduction W",
            "switching W",
            "total W",
            "junction degC",
            "saving %",
        )
    )
    current = 130.0 / (6.0 * 0.1049)
    assert copper[0] == pytest.approx(1.5 * 2e-3 * current**2, abs=0.06)
    assert conduction[0] == pytest.approx(1.5 * 9.5e-3 * current**2, abs=0.06)
    energy = (0.86e-3 + 0.86e-3) * 500.0 / (206.5 * 500.0)
    assert switching[0] == pytest.approx(3.0 * 100e3 * energy * 2.0 * current / math.pi, abs=0.06)
    np.testing.assert_allclose(copper + conduction + switching, total, atol=0.16)
    np.testing.assert_allclose(64.0 + 0.306 / 6.0 * (conduction + switching), junction, atol=0.06)
    np.testing.assert_allclose(100.0 * (1.0 - total / total[0]), saving, atol=0.06)


@pytest.mark.slow
def test_what_is_not_feasible_is_said_and_no_nan_is_printed() -> None:
    """At 500 rad/s i_d = 0 with SPWM is beyond its range, at 1500 rad/s all are.

    At 200 K/W the junction runs away.
    """
    points = (LoadPoint(100.0, 500.0), LoadPoint(130.0, 1500.0))
    hot = replace(MOSFET, thermal_resistance=200.0, on_resistance_temperature_coefficient=0.01)
    for device in (MOSFET, hot):
        design = make_design(replace(IPM, omega_m_max=None))
        inverter = replace(design.inverter, device=device)
        solution = solve(replace(design, inverter=inverter, losses=LossSettings(points)))
        assert solution.losses is not None
        tables = [*losses_tables(design, solution.losses), *run_tables(solution, None)]
        cells = [cell for table in tables for row in table.rows for cell in row]
        assert not [cell for cell in cells if re.search(r"\b(nan|inf)\b", cell)]
        assert {"voltage beyond the linear range", "junction temperature runs away"} & set(cells)
        assert "no alternative is feasible" in cells
        assert "losses at 100 N m, 4775 rpm" in cells


@pytest.mark.slow
def test_segments_are_counted_in_words_that_agree() -> None:
    single = solve(make_design(fit=replace(make_design().fit, segments=1, degree=2)))
    assert (
        run_tables(single, None)[0].rows[0][1].startswith("torque-exact, degree 2, 1 segment, 0 to")
    )
