"""Phase currents of salient machines: physics by energy, optima by other solvers,
and what the firmware evaluates.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import WaveformSettings
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, SalientPhaseMachine, between
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_at_current, mtpa_currents
from dqforge.optimizer.waveforms.comparison import solve_salient
from dqforge.optimizer.waveforms.constraint_rows import (
    OpenPhase,
    WaveformLimits,
    bus_demand,
    dq_waveform,
    pointwise_currents,
)
from dqforge.optimizer.waveforms.firmware_fit import PhasePolynomials, fit_phases
from dqforge.optimizer.waveforms.salient_reference import fit_salient_phases

SETTINGS = WaveformSettings()
HARMONICS = [(2, -2e-3, -2e-3), (4, 3e-4, -2e-4), (6, 1e-4, 5e-5)]


def phases(orders: list[int], amplitudes: list[float], angles: int = 120) -> PhaseMachine:
    return PhaseMachine.from_harmonics(
        orders,
        amplitudes,
        [0.0] * len(orders),
        pole_pairs=2,
        r_s=1.0,
        l_s=7e-3,
        m_s=-1e-3,
        i_max=6.0,
        angles=angles,
    )


def salient(angles: int = 120) -> SalientPhaseMachine:
    orders, own, mutual = zip(*HARMONICS, strict=True)
    base = phases([1, 3, 5, 7], [0.2, 0.024, 0.006, 0.002], angles)
    return SalientPhaseMachine.from_harmonics(base, orders, own, mutual)


def sinusoidal(l_2: float = -2e-3) -> tuple[SalientPhaseMachine, LinearMachine]:
    machine = SalientPhaseMachine.from_harmonics(phases([1], [0.2], 360), [2], [l_2], [l_2])
    return machine, LinearMachine(2, 1.0, 8e-3 + 1.5 * l_2, 8e-3 - 1.5 * l_2, 0.2, 6.0)


def inductance(theta: float) -> FloatArray:
    """The matrix as the documentation writes it, at any angle."""
    turn = 2.0 * np.pi / 3.0
    found = np.full((3, 3), -1e-3) + 8e-3 * np.eye(3)
    for order, own, mutual in HARMONICS:
        for k in range(3):
            found[k, k] += own * np.cos(order * (theta - turn * k))
            j, m = (k + 1) % 3, (k + 2) % 3
            found[j, m] += mutual * np.cos(order * (theta - turn * k))
            found[m, j] += mutual * np.cos(order * (theta - turn * k))
    return found


def test_second_harmonics_are_those_of_the_other_constructor() -> None:
    base = phases([1, 3], [0.2, 0.02])
    one = SalientPhaseMachine.from_harmonics(base, [2], [-1e-3], [-1e-3])
    np.testing.assert_allclose(
        one.inductance, SalientPhaseMachine.with_second_harmonic(base, -1e-3).inductance
    )
    np.testing.assert_allclose(one.dq_inductances, (6.5e-3, 9.5e-3), rtol=1e-12)


def test_dq_inductances_are_the_means_in_rotor_coordinates() -> None:
    """L_s - M_s +- (own/2 + mutual), whatever the ratio of the two; higher orders have no mean."""
    base = phases([1], [0.2])
    machine = SalientPhaseMachine.from_harmonics(base, [2, 4], [-2e-3, 5e-4], [-5e-4, 1e-4])
    np.testing.assert_allclose(machine.dq_inductances, (8e-3 - 1.5e-3, 8e-3 + 1.5e-3), rtol=1e-12)


def test_torque_is_the_change_of_coenergy_under_virtual_displacement() -> None:
    """T = p d/dtheta (i'L i/2 + psi'i) at constant currents, with psi the integral of
    the back-EMF over the angle.
    """
    machine, generator, step = salient(360), np.random.default_rng(4), 1e-4
    orders, amplitudes = np.array([1, 3, 5, 7]), np.array([0.2, 0.024, 0.006, 0.002])
    turn = 2.0 * np.pi / 3.0 * np.arange(3)

    def coenergy(theta: float, currents: FloatArray) -> float:
        own = np.multiply.outer(orders, theta - turn)
        linked = (amplitudes / orders) @ np.cos(own)  # its derivative is -sum A sin(h theta)
        return float(0.5 * currents @ inductance(theta) @ currents + linked @ currents)

    for k in generator.integers(0, 360, 20):
        currents, theta = generator.uniform(-6.0, 6.0, 3), 2.0 * np.pi * k / 360
        wanted = (coenergy(theta + step, currents) - coenergy(theta - step, currents)) / (
            2.0 * step
        )
        found = machine.torque(np.tile(currents[:, np.newaxis], 360))[k]
        assert found == pytest.approx(2.0 * wanted, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize("l_2", [-2e-3, 1.5e-3])
@pytest.mark.parametrize("torque", [0.5, 3.0, -3.0])
def test_without_harmonics_the_optimum_is_the_mtpa_of_dq(l_2: float, torque: float) -> None:
    machine, linear = sinusoidal(l_2)
    i_d, i_q = (float(part[0]) for part in mtpa_currents(linear, np.array([torque])))
    found = pointwise_currents(machine, np.array([torque]), "three-wire")[0]
    np.testing.assert_allclose(found, dq_waveform(i_d, i_q, 360), atol=1e-6)


@pytest.mark.thinned
@pytest.mark.parametrize("topology", ["three-wire", "four-leg"])
@pytest.mark.parametrize("open_phase", [None, "b"])
def test_no_other_solver_finds_less_at_any_angle(
    topology: Topology, open_phase: OpenPhase | None
) -> None:
    """SLSQP from many starts on the torque and what topology and open phase forbid:
    never a smaller |i|^2.
    """
    if topology == "three-wire" and open_phase is not None:
        pytest.skip("a single current cannot make constant torque")
    machine, generator = salient(), np.random.default_rng(8)
    for torque in (-3.0, 0.4, 2.0):
        found = pointwise_currents(machine, np.array([torque]), topology, open_phase)[0]
        np.testing.assert_allclose(machine.torque(found), torque, atol=1e-9)
        for j in generator.integers(0, machine.angles, 4):
            b, a = (
                machine.pole_pairs * machine.flux[:, j],
                0.5 * machine.pole_pairs * machine.slope[j],
            )
            rules = [{"type": "eq", "fun": lambda i, b=b, a=a, t=torque: b @ i + i @ a @ i - t}]
            if topology == "three-wire":
                rules.append({"type": "eq", "fun": np.sum})
            if open_phase is not None:
                rules.append({"type": "eq", "fun": lambda i: i[1]})
            tries = [
                minimize(
                    lambda i: i @ i,
                    generator.uniform(-6.0, 6.0, 3),
                    method="SLSQP",
                    constraints=rules,
                    options={"ftol": 1e-13, "maxiter": 300},
                )
                for _ in range(6)
            ]
            least = min(result.fun for result in tries if result.success)
            assert float(found[:, j] @ found[:, j]) == pytest.approx(least, rel=1e-6)


def test_a_torque_that_no_current_makes_is_refused_by_angle() -> None:
    machine = SalientPhaseMachine.from_harmonics(phases([1], [0.2]), [2], [0.0], [0.0])
    with pytest.raises(NoSolutionError, match=r"constant torque cannot be made near \d+ degrees"):
        pointwise_currents(machine, np.array([1.0]), "three-wire", "a")


def slsqp(machine: SalientPhaseMachine, torque: float, omega_m: float, v_dc: float) -> float:
    """Copper loss in W by another solver on a sixth of the period, six-leg:
    every phase voltage within the bus.
    """
    part = machine.angles // 6
    shift = -np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])

    def whole(x: FloatArray) -> FloatArray:
        pieces = [x.reshape(3, part)]
        for _ in range(5):
            pieces.append(shift @ pieces[-1])
        return np.concatenate(pieces, axis=1)

    start = pointwise_currents(machine, np.array([torque]), "six-leg")[0][:, :part].ravel()
    rules = [
        {"type": "eq", "fun": lambda x: machine.torque(whole(x))[:part] - torque},
        {
            "type": "ineq",
            "fun": lambda x: (
                1.0 - machine.voltage(whole(x), 2.0 * omega_m)[:, :part].ravel() / v_dc
            ),
        },
        {
            "type": "ineq",
            "fun": lambda x: (
                1.0 + machine.voltage(whole(x), 2.0 * omega_m)[:, :part].ravel() / v_dc
            ),
        },
    ]
    found = minimize(
        lambda x: x @ x,
        start,
        jac=lambda x: 2.0 * x,
        method="SLSQP",
        constraints=rules,
        options={"maxiter": 400},
    )
    assert found.success
    return float(machine.copper_loss(whole(found.x)))


def test_ipopt_finds_what_another_solver_finds_where_the_bus_binds() -> None:
    machine = salient(24)
    limits = WaveformLimits(68.0, "six-leg", 20.0)
    found = solve_salient(machine, 3.3, 157.0, limits)
    assert found.binding == ("voltage",)
    assert found.iterations > 0
    assert found.violation < 1e-9
    assert float(bus_demand(found.voltages, "six-leg")) == pytest.approx(68.0, rel=1e-7)
    assert found.floor < 0.9999 * found.copper
    assert found.copper == pytest.approx(slsqp(machine, 3.3, 157.0, 68.0), rel=1e-5)


def test_power_is_kept_where_the_bus_binds() -> None:
    """What goes in is lost in the copper or comes out at the shaft.

    The field's energy comes back every period.
    """
    found = solve_salient(salient(360), 3.3, 157.0, WaveformLimits(120.0, "four-leg", 6.0))
    assert set(found.binding) == {"voltage", "current"}
    power = float(np.mean(np.sum(found.voltages * between(found.currents)[0], axis=0)))
    assert power == pytest.approx(found.copper + 3.3 * 157.0, rel=1e-4)


def test_where_nothing_binds_the_global_optimum_is_proven_without_a_search() -> None:
    found = solve_salient(salient(), 2.0, 50.0, WaveformLimits(220.0, "four-leg", 6.0))
    assert (found.iterations, found.binding) == (0, ())
    assert found.floor == pytest.approx(found.copper, rel=1e-14)


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("topology", "open_phase", "error"),
    [("four-leg", None, 5e-3), ("three-wire", None, 1e-3), ("four-leg", "a", 5e-3)],
)
def test_emitted_currents_keep_their_errors_at_other_torques_and_angles(
    topology: Topology, open_phase: OpenPhase | None, error: float
) -> None:
    machine = salient(360)
    limits = WaveformLimits(220.0, topology, 6.0, open_phase=open_phase)
    fit = fit_salient_phases(machine, limits, replace(SETTINGS, error=error))
    assert isinstance(fit.chosen.form, PhasePolynomials)
    assert fit.chosen.errors.current <= error
    torque = fit.torque_max * np.random.default_rng(2).uniform(-1.0, 1.0, 15)
    theta = 2.0 * np.pi * np.arange(360) / 360
    exact = pointwise_currents(machine, torque, topology, open_phase)
    assert np.max(np.abs(exact)) <= 6.0 * (1.0 + 1e-9)
    for wanted, currents in zip(torque, exact, strict=True):
        angle = (np.sin(theta).astype(np.float32), np.cos(theta).astype(np.float32))
        found = fit.reference.currents(np.full(360, wanted, dtype=np.float32), angle).astype(
            np.float64
        )
        assert np.max(np.abs(found - currents)) <= 1.01 * error * 6.0
        assert (
            np.max(np.abs(machine.torque(found) / wanted - 1.0))
            <= 1.2 * fit.chosen.errors.torque + 1e-6
        )


def test_the_domain_ends_at_the_current_limit() -> None:
    machine, linear = sinusoidal()
    fit = fit_salient_phases(machine, WaveformLimits(220.0, "three-wire", 6.0), SETTINGS)
    i_d, i_q = mtpa_at_current(linear, np.array([6.0]))
    assert fit.torque_max == pytest.approx(
        float(linear.torque(i_d, i_q)[0]), rel=4e-5
    )  # a grid of angles
    end = np.full(360, 1.5 * fit.torque_max, dtype=np.float32)
    theta = 2.0 * np.pi * np.arange(360) / 360
    angle = (np.sin(theta).astype(np.float32), np.cos(theta).astype(np.float32))
    clamped = fit.reference.currents(end, angle)
    np.testing.assert_array_equal(
        clamped, fit.reference.currents(np.full_like(end, fit.reference.torque_max), angle)
    )
    assert np.all(fit.reference.currents(np.zeros_like(end), angle) == 0.0)
    assert np.all(fit.reference.currents(np.full_like(end, np.nan), angle) == 0.0)


def test_without_saliency_the_currents_are_those_of_the_proportional_form() -> None:
    base, limits = (
        phases([1, 3, 5], [0.2, 0.024, 0.006], 360),
        WaveformLimits(220.0, "four-leg", 6.0),
    )
    machine = SalientPhaseMachine.from_harmonics(base, [2], [0.0], [0.0])
    settings = replace(SETTINGS, error=1e-3)
    ours, others = fit_salient_phases(machine, limits, settings), fit_phases(base, limits, settings)
    assert isinstance(ours.chosen.form, PhasePolynomials)
    assert ours.chosen.form.degree == 0
    assert ours.torque_max == pytest.approx(others.torque_max, rel=1e-9)


def test_a_table_is_refused() -> None:
    with pytest.raises(InputError, match=r"waveform.form: a table .* write harmonics"):
        fit_salient_phases(
            salient(), WaveformLimits(220.0, "four-leg", 6.0), replace(SETTINGS, form="table")
        )
