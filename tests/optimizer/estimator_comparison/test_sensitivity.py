"""Slopes of steady errors against closed forms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.design.settings import ObserverSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.names import ObserverMethodName
from dqforge.optimizer.estimator_comparison.candidate import Slopes, slopes_of
from dqforge.optimizer.observers.parts import Load, closed_form_error
from dqforge.optimizer.observers.tuning import tune_position_observer

T_S = 2e-5  # fine, as the closed forms know no sampling
MACHINE = LinearMachine(
    pole_pairs=3, r_s=3.6, l_d=36e-3, l_q=51e-3, psi_pm=0.545, i_max=9.0, inertia=0.015,
    omega_m_max=157.0,
)  # fmt: skip
OMEGA = np.array([0.25, 0.5, 1.0]) * 471.0
LOAD = replace(Load.on(MACHINE, 4.0), i_d=-1.5)


def slopes(name: ObserverMethodName) -> Slopes:
    observer = tune_position_observer(MACHINE, ObserverSettings(method=name), T_S, 540.0, 471.0)
    return slopes_of(observer, LOAD, OMEGA)


@pytest.mark.parametrize("name", ["extended-emf", "open-loop-flux"])
def test_of_the_active_flux(name: ObserverMethodName) -> None:
    """theta^ - theta = arg(psi_pm + (L_d - L_q^) i_d + j (L_q - L_q^) i_q + dR i/(j omega))."""
    found, current = slopes(name), complex(LOAD.i_d, LOAD.i_q)
    for cause in ("r_s", "l_d", "l_q", "psi_pm"):
        ends = [
            closed_form_error(
                replace(MACHINE, **{cause: getattr(MACHINE, cause) * (1.0 + step)}),
                MACHINE,
                current,
                OMEGA,
            )
            for step in (1e-4, -1e-4)
        ]
        expected = (ends[0] - ends[1]) / 2e-4
        assert found.angle[cause] == pytest.approx(expected, rel=0.01, abs=2e-4), cause
    # A volt that is lost along the current is R off by 1/|i|.
    per_volt = found.angle["r_s"] / (MACHINE.r_s * abs(current))
    assert found.angle["dead_time"] == pytest.approx(per_volt, rel=0.01, abs=1e-5)


def first_order(cause: str) -> tuple[np.ndarray, np.ndarray]:
    """The table of docs/methods/estimators.md: e and d of Matsui's models per relative change of
    the machine, which is one of the estimator's own data with the other sign.
    """
    psi_a = MACHINE.psi_pm + (MACHINE.l_d - MACHINE.l_q) * LOAD.i_d
    cross = (MACHINE.l_d - MACHINE.l_q) * LOAD.i_q
    n = psi_a**2 + cross**2
    d_r = -MACHINE.r_s * (cause == "r_s")
    d_ld, d_lq = -MACHINE.l_d * (cause == "l_d"), -MACHINE.l_q * (cause == "l_q")
    d_psi = -MACHINE.psi_pm * (cause == "psi_pm")
    g_gamma = -d_r * LOAD.i_d + OMEGA * d_lq * LOAD.i_q
    g_delta = -d_r * LOAD.i_q - OMEGA * (d_ld * LOAD.i_d + d_psi)
    angle = (cross * g_delta - psi_a * g_gamma) / (n * OMEGA)
    return angle, (psi_a * g_delta + cross * g_gamma) / n


@pytest.mark.thinned
@pytest.mark.parametrize("cause", ["r_s", "l_d", "l_q", "psi_pm"])
def test_of_matsuis_models(cause: str) -> None:
    """First order without what sampling and the finite step of the model leave."""
    angle, speed = first_order(cause)
    voltage, current = slopes("matsui-voltage"), slopes("matsui-current")
    assert voltage.angle[cause] == pytest.approx(angle, rel=0.03, abs=3e-3)
    assert np.abs(voltage.speed[cause]) == pytest.approx(0.0, abs=1e-3)
    assert current.speed[cause] == pytest.approx(speed, rel=0.03, abs=0.01 * 471.0 * 0.1)


def test_a_lost_angle_has_no_slope() -> None:
    observer = tune_position_observer(
        MACHINE, ObserverSettings(method="extended-emf"), T_S, 540.0, 471.0
    )
    found = slopes_of(observer, LOAD, np.array([1e-3, 200.0]))
    assert np.isnan(found.angle["r_s"][0])
    assert np.isfinite(found.angle["r_s"][1])
