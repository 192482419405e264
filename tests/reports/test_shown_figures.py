"""What tables, report and figures show of operating points, references and waveforms
stands in results and JSON.
"""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drives import IPM, make_design

from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import FitSettings, OperationSettings
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.current_reference.solve import solve_fit
from dqforge.optimizer.curves.single_precision import PiecewisePolynomial
from dqforge.optimizer.losses.solve import require_losses
from dqforge.optimizer.operating_points.characteristics import (
    LimitedDrive,
    VoltageLimit,
    points_within,
)
from dqforge.optimizer.operating_points.solve import solve_curves
from dqforge.optimizer.waveforms.comparison import compare_waveforms, require_phases
from dqforge.optimizer.waveforms.constraint_rows import unit_currents
from dqforge.optimizer.waveforms.solve import solve_phases
from dqforge.reports.current_reference.plain import plain_fit
from dqforge.reports.losses.map_tables import plain_losses
from dqforge.reports.operating_points.map_tables import plain_curves
from dqforge.reports.pages.html_text import operation_text
from dqforge.reports.pages.templating import to_text
from dqforge.reports.waveforms.tables import plain_phase_fit, plain_waveforms


def read_back(plain: dict[str, Any] | None) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(to_text("test", "test", {"found": plain}))["found"]
    return found


def test_copper_loss_and_what_is_saved_are_those_of_the_currents() -> None:
    """3/2 R |i|^2.

    The last torque of i_d = 0 within 283 A is 3/2 p psi i, 178.1 N m, below the 206 N m of MTPA.
    """
    curves = solve_curves(make_design())
    found = read_back(plain_curves(curves))
    chosen, id0, saving = found["chosen"], found["id0"], found["saving"]
    current = np.hypot(chosen["i_d_A"], chosen["i_q_A"])
    np.testing.assert_allclose(chosen["current_A"], current, rtol=1e-8)
    np.testing.assert_allclose(chosen["copper_W"], 1.5 * IPM.r_s * current**2, rtol=1e-7)
    last = max(k for k, limited in enumerate(id0["limited"]) if not limited)
    assert saving["torque_Nm"] == chosen["torque_Nm"][last]
    assert saving["torque_Nm"] <= 6.0 * IPM.psi_pm * IPM.i_max < chosen["torque_Nm"][last + 1]
    assert saving["copper_id0_W"] == pytest.approx(
        1.5 * IPM.r_s * (saving["torque_Nm"] / (6.0 * IPM.psi_pm)) ** 2
    )
    assert saving["relative"] == pytest.approx(
        1.0 - saving["copper_W"] / saving["copper_id0_W"], rel=1e-7
    )
    assert 0.05 < saving["relative"] < 0.5
    assert found["holds_at"] is None


@pytest.mark.parametrize(
    "same", [make_design(strategy="id0"), make_design(replace(IPM, l_q=IPM.l_d))]
)
def test_nothing_is_saved_where_the_currents_are_the_same(same: Any) -> None:
    assert read_back(plain_curves(solve_curves(same)))["saving"] is None


def test_a_reference_at_a_speed_says_which_and_the_voltage_there() -> None:
    """SVPWM at 500 V less 5 %: 500/sqrt(3) 0.95 = 274.2 V."""
    operation = OperationSettings("mtpa", 700.0, "svpwm", 0.05)
    design = replace(make_design(fit=FitSettings(form="polynomial", degree=4)), operation=operation)
    chosen = solve_fit(design)
    for plain in (plain_fit(chosen.fit, ()), plain_curves(solve_curves(design))):
        place = read_back(plain)["holds_at"]
        assert place["omega_m_rad_per_s"] == 700.0
        assert place["v_max_V"] == pytest.approx(500.0 / math.sqrt(3.0) * 0.95, rel=1e-8)
    assert operation_text(chosen.fit.speed) == "6685 rpm within 274.2 V (phase peak)"
    assert chosen.fit.errors.voltage_excess is not None
    found = chosen.fit.reference.currents(chosen.fit.curves.torque)
    i_d, i_q = (np.asarray(axis, dtype=np.float64) for axis in found)
    voltage = np.hypot(*IPM.voltage(i_d, i_q, np.full_like(i_d, 2800.0)))
    np.testing.assert_allclose(chosen.fit.curves.voltage, voltage, rtol=1e-5)


def test_error_curves_belong_to_the_reference_that_they_stand_beside() -> None:
    fit = solve_fit(make_design(fit=FitSettings(form="polynomial", degree=3, segments=2))).fit
    assert isinstance(fit.d, PiecewisePolynomial)
    i_d, i_q = (
        np.asarray(part, dtype=np.float64) for part in fit.reference.currents(fit.curves.torque)
    )
    np.testing.assert_allclose(
        fit.curves.torque_error, IPM.torque(i_d, i_q) - fit.curves.torque, atol=1e-9
    )
    largest = float(np.max(np.abs(fit.curves.torque_error)))
    assert 0.9 * fit.errors.torque < largest <= fit.errors.torque * 1.01
    found = read_back(plain_fit(fit, ()))
    assert (found["breakpoints"], found["exact_at_zero"], found["continuous"]) == (
        "searched",
        True,
        True,
    )


def test_losses_say_what_stands_in_the_way() -> None:
    design = catalogue.load("paper000-ipmsm-100kw")
    assert design.losses is not None
    point = replace(design.losses.points[0], torque=1.5 * 240.0)
    rows = read_back(
        plain_losses(
            require_losses(replace(design, losses=replace(design.losses, points=(point,))))
        )
    )
    for row in rows["rows"]:
        assert not row["feasible"]
        assert row["obstacle"] == f"torque out of reach, at most {row['torque_made_Nm']:.4g} N m"
        assert 0.0 < row["torque_made_Nm"] < row["torque_Nm"]


def test_points_have_the_efficiency_of_their_power_and_losses() -> None:
    design, limit = make_design(), VoltageLimit("svpwm", 500.0, 0.0, 500.0 / math.sqrt(3.0))
    drive = LimitedDrive(design.machine, design.inverter, limit, design.i_max)
    found = points_within(drive, np.array([100.0, -100.0, 0.0]), 300.0)
    np.testing.assert_allclose(found.power, [3e4, -3e4, 0.0], atol=1e-6)
    loss = found.losses.total
    np.testing.assert_allclose(
        found.efficiency[:2], [3e4 / (3e4 + loss[0]), (3e4 - loss[1]) / 3e4], rtol=1e-9
    )
    assert math.isnan(found.efficiency[2])


def test_harmonics_hold_the_whole_current() -> None:
    """Parseval: half the squares of the amplitudes are the mean square of a phase current."""
    design = catalogue.load("paper002-phase-waveforms")
    comparison = compare_waveforms(design)
    rules = read_back(plain_waveforms(comparison))["rules"]
    for rule, found in rules.items():
        harmonics = np.array(found["harmonics_A"])
        assert harmonics.shape == (3, 50)
        square = np.mean(np.square(found["currents_A"]), axis=1)
        np.testing.assert_allclose(
            harmonics[:, 0] ** 2 + 0.5 * np.sum(harmonics[:, 1:] ** 2, axis=1), square, rtol=2e-3
        )
        assert found["mean_torque_Nm"] == pytest.approx(np.mean(found["torque_Nm"]), rel=1e-7), rule
    machine = require_phases(design)
    assert isinstance(machine, PhaseMachine)
    sine = comparison.torque * np.max(unit_currents(machine, "dq"))
    assert rules["dq"]["harmonics_A"][0][1] == pytest.approx(sine, rel=1e-4)


def test_forms_for_the_firmware_are_listed_with_their_price() -> None:
    fit = solve_phases(catalogue.load("paper002-phase-waveforms"))
    found = read_back(plain_phase_fit(fit))
    assert found["chosen"] == found["candidates"][0]["form"]
    assert [(row["constants_B"], row["operations"]) for row in found["candidates"]] == [
        (entry.flash, entry.operations) for entry in fit.candidates
    ]
    assert all(0.0 < row["errors"]["current"] < 1.0 for row in found["candidates"])
