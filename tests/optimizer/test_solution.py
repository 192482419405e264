"""A design solved as a whole: each part gets the values of its own axis,
strategy and operating point.
"""

from __future__ import annotations

from dataclasses import replace

import pytest
from drives import IPM, SURFACE, make_design

from dqforge.machines.design.settings import LoadPoint, LossSettings
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.losses.solve import solve_losses
from dqforge.optimizer.operating_points.solve import solve_curves


def test_each_axis_is_tuned_for_its_own_inductance() -> None:
    """Bandwidth 6283 rad/s: kp = w L, ki = w R on both axes."""
    gains = solve_gains(make_design())
    assert (gains.i_d.loop, gains.i_q.loop) == ("i_d", "i_q")
    assert gains.i_d.kp == pytest.approx(6283.0 * 350e-6)
    assert gains.i_q.kp == pytest.approx(6283.0 * 592e-6)
    assert gains.i_d.ki == gains.i_q.ki == pytest.approx(6283.0 * 2e-3)


def test_what_is_saved_is_a_share_of_the_loss_without_d_current() -> None:
    """3/2 R (T / (3/2 p psi))^2 at i_d = 0; less with MTPA by no more than half."""
    saving = solve_curves(make_design()).saving
    assert saving is not None
    i_q = saving.torque / (1.5 * IPM.pole_pairs * IPM.psi_pm)
    assert saving.id0 == pytest.approx(1.5 * IPM.r_s * i_q**2, rel=1e-6)
    assert saving.chosen == pytest.approx((1.0 - saving.relative) * saving.id0, rel=1e-9)
    assert 0.05 < saving.relative < 0.5


def test_braking_loses_as_much_as_driving_in_copper_and_less_voltage() -> None:
    """With -T the current is mirrored in i_q: the same copper and MOSFET conduction loss;
    r_s i_q helps the voltage.
    """
    design = replace(
        make_design(), losses=LossSettings((LoadPoint(130.0, 300.0), LoadPoint(-130.0, 300.0)))
    )
    comparison = solve_losses(design)
    assert comparison is not None
    budget = comparison.budget
    assert budget.copper[..., 1] == pytest.approx(budget.copper[..., 0])
    assert budget.conduction[..., 1] == pytest.approx(budget.conduction[..., 0])
    assert (budget.voltage[..., 1] < budget.voltage[..., 0]).all()
    assert budget.torque[..., 1] == pytest.approx(-130.0)


def test_bases_exist_only_where_the_curve_has_a_scale() -> None:
    base = solve_curves(make_design(IPM)).base
    assert base is not None
    assert base.current == pytest.approx(0.1049 / (2.0 * 242e-6))
    assert solve_curves(make_design(SURFACE)).base is None
