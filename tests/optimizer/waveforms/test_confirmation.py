"""The second opinion on waveform programmes: it agrees where it must,
and finds what was made wrong on purpose.
"""

from __future__ import annotations

import builtins
from dataclasses import replace
from typing import Any

import cvxpy as cp
import numpy as np
import pytest

from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.waveforms.constraint_rows import WaveformLimits, make_problem
from dqforge.optimizer.waveforms.solver import AGREEMENT, confirm_waveforms, solve_waveforms

MACHINE = PhaseMachine.from_harmonics(
    [1, 3, 5, 7],
    [0.2233, 0.0268, 0.0067, 0.0022],
    [0.0] * 4,
    pole_pairs=2,
    r_s=1.0,
    l_s=7e-3,
    m_s=-1e-3,
    i_max=5.94,
    angles=120,
)
LIMITS = WaveformLimits(150.0, "four-leg", 5.94)
CASES: dict[str, tuple[float, float, WaveformLimits]] = {
    "nothing binds": (1.0, 78.0, LIMITS),
    "four-leg": (3.5, 188.0, LIMITS),
    "three-wire": (3.5, 188.0, replace(LIMITS, topology="three-wire", ripple=0.1)),
    "split capacitor": (3.0, 188.0, replace(LIMITS, topology="split-capacitor")),
    "six-leg": (3.0, -188.0, replace(LIMITS, topology="six-leg", v_dc=80.0)),
    "diode neutral": (
        3.0,
        160.0,
        replace(LIMITS, topology="diode-neutral", ripple=0.6, neutral=1.0),
    ),
    "neutral": (3.5, 160.0, replace(LIMITS, neutral=0.5)),
    "slew": (3.0, 150.0, replace(LIMITS, slew=2400.0)),
    "open phase": (2.0, 150.0, replace(LIMITS, ripple=0.3, open_phase="b")),
    "generating": (-3.5, 200.0, replace(LIMITS, ripple=0.2)),
}
INFEASIBLE: dict[str, tuple[float, float, WaveformLimits]] = {
    "bus": (3.5, 188.0, replace(LIMITS, v_dc=110.0)),
    "current": (9.0, 50.0, LIMITS),
    "current with ripple": (9.0, 50.0, replace(LIMITS, ripple=0.3)),
    "slew": (3.0, 188.0, replace(LIMITS, v_dc=400.0, slew=900.0)),
}


@pytest.mark.parametrize("name", CASES)
def test_osqp_confirms_what_is_optimal(name: str, capfd: pytest.CaptureFixture[str]) -> None:
    torque, omega_m, limits = CASES[name]
    found = solve_waveforms(MACHINE, torque, omega_m, limits)
    (entry,) = confirm_waveforms(MACHINE, found, limits)
    assert entry.verdict == "confirmed"
    assert entry.theirs.largest < 1e-8
    assert abs(entry.loss_difference) < 1e-8
    assert entry.current_difference < 1e-4 * limits.i_max
    assert confirm_waveforms(MACHINE, found, limits) == (entry,)
    assert capfd.readouterr().out == ""  # plain data go there


@pytest.mark.parametrize("name", INFEASIBLE)
def test_osqp_proves_what_cannot_be_had(name: str) -> None:
    """The ray of multipliers is checked here.

    That there are none is checked by an interior-point method, too.
    """
    torque, omega_m, limits = INFEASIBLE[name]
    found = solve_waveforms(MACHINE, torque, omega_m, limits)
    assert found.status == ("infeasible",)
    (entry,) = confirm_waveforms(MACHINE, found, limits)
    assert entry.verdict == "confirmed infeasible"
    point = make_problem(MACHINE, limits).point(torque, MACHINE.pole_pairs * omega_m)
    z = cp.Variable(point.gradient.size)
    rows = point.matrix @ z
    problem = cp.Problem(cp.Minimize(0), [rows <= point.upper, rows >= point.lower])
    problem.solve(solver=cp.CLARABEL)
    assert problem.status == cp.INFEASIBLE


@pytest.mark.parametrize(
    "change", ["scaled", "shifted", "stationarity", "violation", "complementarity", "claimed"]
)
def test_what_is_not_optimal_is_not_confirmed(change: str) -> None:
    """Every figure of ours that goes into the verdict, spoilt one at a time."""
    torque, omega_m, limits = CASES["four-leg"]
    found = solve_waveforms(MACHINE, torque, omega_m, limits)
    spoilt: dict[str, Any] = {
        "scaled": {"copper": found.copper * (1.0 + 10.0 * AGREEMENT)},
        "shifted": {"copper": found.copper * (1.0 - 10.0 * AGREEMENT)},
        "stationarity": {"stationarity": np.array([10.0 * AGREEMENT])},
        "violation": {"violation": np.array([10.0 * AGREEMENT])},
        "complementarity": {"complementarity": np.array([10.0 * AGREEMENT])},
        "claimed": {"status": ("infeasible",)},
    }
    (entry,) = confirm_waveforms(MACHINE, replace(found, **spoilt[change]), limits)
    assert entry.verdict == "differs"


def test_a_point_that_cannot_be_had_is_not_confirmed_as_solved() -> None:
    torque, omega_m, limits = INFEASIBLE["bus"]
    solved = solve_waveforms(MACHINE, torque, omega_m, LIMITS)
    (entry,) = confirm_waveforms(MACHINE, solved, limits)
    assert entry.verdict == "differs"


def test_without_osqp_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def missing(name: str, *rest: Any, **named: Any) -> Any:
        if name == "osqp":
            raise ImportError(name)
        return real(name, *rest, **named)

    torque, omega_m, limits = CASES["four-leg"]
    found = solve_waveforms(MACHINE, torque, omega_m, limits)
    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(InputError, match="needs osqp; install it with: pip install osqp"):
        confirm_waveforms(MACHINE, found, limits)
