"""A design solved as a whole: each part gets the values of its own axis,
strategy and operating point.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import IPM, SURFACE, make_design

from dqforge.machines.design.settings import LoadPoint, LossSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import Strategy
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.losses.solve import solve_losses
from dqforge.optimizer.operating_points.solve import solve_curves
from dqforge.optimizer.solution import _observer_errors


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


@pytest.mark.parametrize("machine", [IPM, SURFACE, replace(SURFACE, l_q=0.8e-3)])
@pytest.mark.parametrize("strategy", ["id0", "mtpa"])
@pytest.mark.parametrize("end", [None, 3.0])
def test_curves_begin_without_torque_and_end_at_the_limit(
    machine: LinearMachine, strategy: Strategy, end: float | None
) -> None:
    """The end by brute force on the limit circle; the saving at the last torque of both."""
    curves = solve_curves(make_design(machine, strategy=strategy), end)
    assert curves.speed is None
    angle = np.linspace(0.0, np.pi, 40_001) if strategy == "mtpa" else np.array([0.5 * np.pi])
    i_d, i_q = machine.i_max * np.cos(angle), machine.i_max * np.sin(angle)
    kt = 1.5 * machine.pole_pairs
    most = float(np.max(kt * (machine.psi_pm + (machine.l_d - machine.l_q) * i_d) * i_q))
    last = most if end is None else end
    assert curves.chosen.torque[[0, -1]] == pytest.approx((0.0, last), rel=1e-3, abs=1e-12)
    np.testing.assert_allclose(np.diff(curves.chosen.torque, 2), 0.0, atol=1e-9 * last)
    id0 = curves.id0
    assert id0 is not None
    salient = machine.l_d != machine.l_q
    assert (curves.base is not None) == salient
    assert (curves.saving is not None) == (salient and strategy == "mtpa")
    if curves.saving is not None:
        both = curves.chosen.torque <= kt * machine.psi_pm * machine.i_max
        torque = float(curves.chosen.torque[both][-1])
        place = int(np.flatnonzero(both)[-1])
        assert curves.saving.torque == pytest.approx(torque)
        i_q = torque / (kt * machine.psi_pm)
        assert curves.saving.id0 == pytest.approx(1.5 * machine.r_s * i_q**2)
        size = np.hypot(curves.chosen.i_d[place], curves.chosen.i_q[place])
        assert curves.saving.chosen == pytest.approx(1.5 * machine.r_s * size**2)
        assert curves.saving.relative == pytest.approx(
            1.0 - curves.saving.chosen / curves.saving.id0
        )


def test_a_speed_has_the_voltage_of_the_design_and_no_curve_beside_it() -> None:
    design = make_design()
    design = replace(design, operation=replace(design.operation, omega_m=300.0))
    curves = solve_curves(design)
    assert curves.id0 is None
    assert curves.saving is None
    assert curves.speed is not None
    assert (curves.speed.omega_m, curves.speed.v_max) == (300.0, design.v_max)


def test_the_speed_observer_is_judged_at_half_speed_and_half_torque(
    bench001: LinearMachine,
) -> None:
    design = make_design(bench001)
    gains = solve_gains(design)
    assert gains.observer is not None
    at_rest, loaded = _observer_errors(design, gains, 1.2)
    assert (at_rest.torque_load, loaded.torque_load) == (0.0, 0.6)
    for one in (at_rest, loaded):
        assert one.exact.omega_m == pytest.approx(0.5 * design.control.bases.speed)
    assert _observer_errors(design, None, 1.2) == ()


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
