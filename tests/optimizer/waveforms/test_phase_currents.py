"""Closed forms of phase currents against the thesis and linear algebra,
and salient machines against exact MTPA.
"""

from __future__ import annotations

import importlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, SalientPhaseMachine, between
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_currents
from dqforge.optimizer.operating_points.points import optimal_points
from dqforge.optimizer.waveforms.comparison import solve_salient
from dqforge.optimizer.waveforms.constraint_rows import (
    WaveformLimits,
    bus_demand,
    figures,
    spectrum,
    unit_currents,
)
from dqforge.optimizer.waveforms.solver import solve_waveforms

ANGLES = 360
THETA = 2.0 * np.pi * np.arange(ANGLES) / ANGLES
TURNS = THETA - 2.0 * np.pi / 3.0 * np.arange(3)[:, np.newaxis]
MACHINE = PhaseMachine.from_harmonics(
    [1, 3, 5, 7],
    [0.2, 0.036, 0.012, 0.006],
    [0.0, 0.0, np.pi, 0.0],
    pole_pairs=2,
    r_s=1.0,
    l_s=8e-3,
    m_s=-1e-3,
    i_max=14.0,
)
STAR = WaveformLimits(130.0, "three-wire", 14.0)


def drive(shape: FloatArray) -> PhaseMachine:
    return PhaseMachine(2, 1.0, 8e-3, -1e-3, 0.2 * shape, 14.0)


def sine(*amplitudes: float) -> FloatArray:
    return -np.array(amplitudes)[:, np.newaxis] * np.sin(TURNS)


def trapezoid() -> FloatArray:
    """Flat over 120 degrees, straight in between."""
    return -np.clip(np.arcsin(np.sin(TURNS)) * 6.0 / np.pi, -1.0, 1.0)


@pytest.mark.parametrize(
    ("shape", "ratio"),
    [(sine(1, 1, 1), 1.0), (sine(0.5, 1, 1), 1.061), (sine(0, 1, 1), 1.732), (trapezoid(), 1.042)],
    ids=["balanced", "one phase at half amplitude", "one phase missing", "trapezoid"],
)
def test_copper_loss_without_zero_sequence_beside_that_with_it(
    shape: FloatArray, ratio: float
) -> None:
    """Shapes of the thesis, table 3.1.

    The ratios follow from its transformations at the same constant torque.
    """
    machine = drive(shape)
    dqx, dqy = (machine.copper_loss(unit_currents(machine, rule)) for rule in ("dqx", "dqy"))
    assert float(dqx / dqy) == pytest.approx(ratio, abs=6e-4)


@pytest.mark.parametrize("rule", ["dqx", "dqy"])
def test_constant_torque_needs_the_least_current_at_every_angle(rule: Any) -> None:
    """The pseudo-inverse of what must hold, angle by angle, is the shortest vector of currents."""
    currents = unit_currents(MACHINE, rule)
    np.testing.assert_allclose(MACHINE.torque(currents), 1.0, atol=1e-12)
    rows = np.stack([MACHINE.pole_pairs * MACHINE.flux.T, np.ones((ANGLES, 3))], axis=1)
    rows, wanted = (rows, np.array([1.0, 0.0])) if rule == "dqx" else (rows[:, :1], np.array([1.0]))
    np.testing.assert_allclose(currents.T, np.linalg.pinv(rows) @ wanted, atol=1e-12)


def test_dq_keeps_the_mean_torque_and_leaves_the_ripple_of_the_harmonics() -> None:
    """Sinusoidal currents against e5 and e7: harmonics of the torque at 6 with the
    difference of the two amplitudes.
    """
    currents = 3.0 * unit_currents(MACHINE, "dq")
    torque = MACHINE.torque(currents)
    assert np.mean(torque) == pytest.approx(3.0, rel=1e-12)
    lines, orders = spectrum(currents)
    np.testing.assert_allclose(lines[:, 1], 3.0 / (1.5 * 2 * 0.2), rtol=1e-12)
    assert np.max(np.delete(lines, 1, axis=1)) < 1e-12
    assert orders[1] == 1.0
    # -e5 and +e7 act with opposite signs on the fundamental current:
    # 0.012 (turned by pi) and 0.006 add.
    sixth = 2.0 * np.abs(np.fft.rfft(torque)[6]) / ANGLES
    assert sixth == pytest.approx(3.0 * (0.012 + 0.006) / 0.2, rel=1e-9)


@pytest.mark.parametrize("rule", ["dqx", "dqy"])
def test_an_angle_without_torque_is_named(rule: Any) -> None:
    """Phases b and c lost: phase a alone makes no torque where its back-EMF vanishes."""
    with pytest.raises(NoSolutionError, match=rf"{rule}: at (0|180) degrees no phase makes torque"):
        unit_currents(drive(sine(1, 0, 0)), rule)


def legs_reach(voltages: FloatArray, topology: Topology) -> float:
    """Least dc link for three phase voltages at one instant, from the potentials
    of the bridge as unknowns.
    """
    # Unknowns: potentials of three legs, of the neutral or of three second legs, and v_dc.
    ends = 3 if topology == "six-leg" else 1
    equal = np.zeros((3, 3 + ends + 1))
    for phase in range(3):
        equal[phase, phase] = 1.0
        equal[phase, 3 + (phase if ends == 3 else 0)] = -1.0
    wanted = voltages
    if topology == "split-capacitor":
        middle = np.zeros((1, 5))
        middle[0, 3:] = 1.0, -0.5
        equal, wanted = np.vstack([equal, middle]), np.append(voltages, 0.0)
    held = 3 if topology == "three-wire" else 3 + ends
    below = np.hstack([np.eye(held, 3 + ends), -np.ones((held, 1))])
    above_zero = np.hstack([-np.eye(held, 3 + ends), np.zeros((held, 1))])
    found = linprog(
        np.eye(3 + ends + 1)[-1],
        A_ub=np.vstack([below, above_zero]),
        b_ub=np.zeros(2 * held),
        A_eq=equal,
        b_eq=wanted,
        bounds=(None, None),
    )
    return float(found.x[-1])


@pytest.mark.parametrize("topology", ["three-wire", "four-leg", "split-capacitor", "six-leg"])
def test_bus_demand_follows_from_the_potentials_of_the_bridge(topology: Topology) -> None:
    voltages = np.random.default_rng(5).normal(size=(12, 3)) * 100.0 + 60.0
    for instant in voltages:
        assert float(bus_demand(instant[:, np.newaxis], topology)) == pytest.approx(
            legs_reach(instant, topology), rel=1e-9
        )


def test_figures_of_dqy() -> None:
    currents = np.stack([2.0 * unit_currents(MACHINE, "dqy"), 4.0 * unit_currents(MACHINE, "dq")])
    found = figures(MACHINE, currents, np.array([100.0, 100.0]), "four-leg")
    np.testing.assert_allclose(found.torque, [2.0, 4.0], rtol=1e-12)
    assert found.ripple[0] < 1e-12
    np.testing.assert_allclose(found.copper, 3.0 * found.rms**2, rtol=1e-12)
    assert found.neutral_rms[0] > 0.1
    assert found.neutral_rms[1] < 1e-12
    assert found.peak[1] == pytest.approx(4.0 / (1.5 * 2 * 0.2), rel=1e-12)


SALIENT_BENCH = LinearMachine(4, 2e-3, 350e-6, 592e-6, 0.1049, 400.0)


def sinusoidal(machine: LinearMachine, angles: int = 120) -> SalientPhaseMachine:
    """The same machine in phase quantities."""
    mean = 0.5 * (machine.l_d + machine.l_q)
    phases = PhaseMachine.from_harmonics(
        [1],
        [machine.psi_pm],
        [0.0],
        pole_pairs=machine.pole_pairs,
        r_s=machine.r_s,
        l_s=0.8 * mean,
        m_s=-0.2 * mean,
        i_max=machine.i_max,
        angles=angles,
    )
    return SalientPhaseMachine.with_second_harmonic(phases, (machine.l_d - machine.l_q) / 3.0)


def rotating(i_d: float, i_q: float, angles: int = 120) -> FloatArray:
    """Phase currents of constant dq currents, shape (3, N)."""
    turns = 2.0 * np.pi * (np.arange(angles) / angles - np.arange(3)[:, np.newaxis] / 3.0)
    return i_d * np.cos(turns) - i_q * np.sin(turns)


def test_phase_model_of_a_salient_machine_is_its_dq_model() -> None:
    machine, i_d, i_q, omega_e = sinusoidal(SALIENT_BENCH), -80.0, 120.0, 400.0
    currents = rotating(i_d, i_q)
    wanted = SALIENT_BENCH.torque(np.array(i_d), np.array(i_q))
    np.testing.assert_allclose(machine.torque(currents), wanted, rtol=1e-7)
    v_d = 2e-3 * i_d - omega_e * 592e-6 * i_q
    v_q = 2e-3 * i_q + omega_e * (350e-6 * i_d + 0.1049)
    np.testing.assert_allclose(
        machine.voltage(currents, omega_e), between(rotating(v_d, v_q))[0], atol=1e-5
    )
    assert machine.symmetry == "sixth"


@pytest.mark.parametrize("torque", [50.0, 200.0, -150.0])
@pytest.mark.parametrize("machine", [SALIENT_BENCH, replace(SALIENT_BENCH, l_d=700e-6, l_q=450e-6)])
def test_salient_currents_are_the_exact_mtpa(machine: LinearMachine, torque: float) -> None:
    found = solve_salient(
        sinusoidal(machine), torque, 100.0, WaveformLimits(1e4, "three-wire", 400.0)
    )
    i_d, i_q = (float(part[0]) for part in mtpa_currents(machine, np.array([torque])))
    assert found.copper == pytest.approx(1.5 * machine.r_s * (i_d**2 + i_q**2), rel=1e-6)
    np.testing.assert_allclose(found.currents, rotating(i_d, i_q), atol=1e-6 * 400.0)
    np.testing.assert_allclose(found.torque, torque, rtol=1e-9)


def test_salient_currents_under_a_voltage_limit_cost_between_mtpa_and_the_inscribed_circle() -> (
    None
):
    """Constant dq currents within v_dc/sqrt(3) are permitted, so that the free
    waveform is at least as good.
    """
    torque, omega_m, v_dc = 150.0, 300.0, 260.0
    limits = WaveformLimits(v_dc, "three-wire", 400.0)
    circle = optimal_points(
        SALIENT_BENCH, np.array([torque]), np.array([omega_m]), v_max=v_dc / np.sqrt(3.0)
    )
    assert circle.torque[0] == pytest.approx(torque, rel=1e-9)
    most = 1.5 * SALIENT_BENCH.r_s * (circle.i_d[0] ** 2 + circle.i_q[0] ** 2)
    i_d, i_q = mtpa_currents(SALIENT_BENCH, np.array([torque]))
    least = 1.5 * SALIENT_BENCH.r_s * float(i_d[0] ** 2 + i_q[0] ** 2)
    machine = sinusoidal(SALIENT_BENCH)
    found = solve_salient(machine, torque, omega_m, limits)
    assert 1.001 * least < found.copper < 0.9999 * most
    assert float(bus_demand(found.voltages, "three-wire")) == pytest.approx(v_dc, rel=1e-7)
    np.testing.assert_allclose(found.torque, torque, rtol=1e-9)
    # What goes in is lost in the copper or comes out at the shaft;
    # the difference is that of the stencil.
    power = float(np.mean(np.sum(found.voltages * between(found.currents)[0], axis=0)))
    assert power == pytest.approx(found.copper + torque * omega_m, rel=1e-5)


CASES: dict[str, tuple[float, float, WaveformLimits]] = {
    "bus, three-wire": (4.0, 180.0, STAR),
    "bus, four-leg": (4.0, 190.0, replace(STAR, v_dc=140.0, topology="four-leg")),
    "bus, split capacitor": (4.0, 190.0, replace(STAR, v_dc=150.0, topology="split-capacitor")),
    "bus, six-leg": (4.0, 190.0, replace(STAR, v_dc=70.0, topology="six-leg")),
    "ripple": (4.0, 180.0, replace(STAR, v_dc=140.0, ripple=0.4)),
    "neutral": (4.0, 180.0, replace(STAR, v_dc=140.0, topology="four-leg", neutral=1.0)),
    "slew": (4.0, 150.0, replace(STAR, v_dc=200.0, slew=2400.0)),
    "open phase": (2.0, 190.0, replace(STAR, v_dc=152.0, topology="four-leg", open_phase="b")),
    "open phase, split capacitor": (
        2.0,
        150.0,
        replace(STAR, topology="split-capacitor", ripple=0.5, open_phase="c"),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_without_saliency_the_nonlinear_programme_is_the_quadratic_one(name: str) -> None:
    torque, omega_m, limits = CASES[name]
    phases = replace(MACHINE, flux=MACHINE.flux[:, ::3])
    quadratic = solve_waveforms(phases, torque, omega_m, limits)
    assert quadratic.status == ("solved",)
    found = solve_salient(
        SalientPhaseMachine.with_second_harmonic(phases, 0.0), torque, omega_m, limits
    )
    assert found.copper == pytest.approx(quadratic.copper[0], rel=1e-6)
    assert found.violation < 1e-9
    np.testing.assert_allclose(found.currents, quadratic.currents[0], atol=2e-4 * limits.i_max)


def test_even_harmonics_leave_a_third_of_the_period() -> None:
    phases = PhaseMachine.from_harmonics(
        [1, 2, 3],
        [0.2, 0.02, 0.03],
        [0.0, 0.3, 0.1],
        pole_pairs=2,
        r_s=1.0,
        l_s=8e-3,
        m_s=-1e-3,
        i_max=14.0,
        angles=120,
    )
    machine = SalientPhaseMachine.with_second_harmonic(phases, 0.0)
    assert machine.symmetry == "third"
    limits = replace(STAR, v_dc=150.0, topology="split-capacitor")
    found, quadratic = (
        solve_salient(machine, 4.0, 180.0, limits),
        solve_waveforms(phases, 4.0, 180.0, limits),
    )
    assert quadratic.status == ("solved",)
    assert found.copper == pytest.approx(quadratic.copper[0], rel=1e-6)


def test_less_symmetry_gives_the_same_salient_currents() -> None:
    """A trace of another harmonic takes the mirrored half waves away.

    The whole period is then solved for.
    """
    phases = replace(MACHINE, flux=MACHINE.flux[:, ::3])
    whole = sinusoidal(SALIENT_BENCH).inductance * 15.0
    uneven = whole * (1.0 + 1e-8 * np.arange(3))[:, np.newaxis] * (1.0 + 1e-8 * np.arange(3))
    machines = [SalientPhaseMachine(phases, inductance) for inductance in (whole, uneven)]
    assert [machine.symmetry for machine in machines] == ["sixth", "none"]
    limits = replace(STAR, v_dc=150.0, topology="four-leg")
    first, second = (solve_salient(machine, 4.0, 180.0, limits) for machine in machines)
    assert first.copper == pytest.approx(second.copper, rel=1e-6)


def test_what_makes_no_salient_machine_or_no_currents_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    machine = sinusoidal(SALIENT_BENCH)
    with pytest.raises(InputError, match=r"need the shape \(120, 3, 3\), got \(60, 3, 3\)"):
        SalientPhaseMachine(machine.phases, machine.inductance[:60])
    with pytest.raises(InputError, match="must be symmetric"):
        SalientPhaseMachine(machine.phases, machine.inductance + np.triu(np.full((3, 3), 1e-5), 1))
    with pytest.raises(InputError, match="store no energy"):
        SalientPhaseMachine.with_second_harmonic(machine.phases, 1e-3)
    with pytest.raises(InputError, match="must be finite"):
        SalientPhaseMachine(machine.phases, machine.inductance * np.nan)
    with pytest.raises(InputError, match="torque and speed must be finite"):
        solve_salient(machine, np.nan, 1.0, STAR)
    with pytest.raises(InputError, match="diode-neutral is not offered"):
        solve_salient(machine, 1.0, 1.0, replace(STAR, topology="diode-neutral"))
    with pytest.raises(
        NoSolutionError, match=r"no phase currents found for 50 N m at 955 rpm within 10 V"
    ):
        solve_salient(machine, 50.0, 100.0 * 1.00006, WaveformLimits(10.0, "three-wire", 400.0))

    def missing(name: str) -> Any:
        raise ImportError(name)

    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(InputError, match="need casadi; install it with: pip install casadi"):
        solve_salient(machine, 1.0, 1.0, STAR)
