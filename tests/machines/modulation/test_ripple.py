"""Ripple against switching simulated by comparing duty cycles with a triangular carrier."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from drives import INVERSE_SALIENT, IPM, SURFACE
from modulators import CONTINUOUS, duties
from saturated import ArctanMachine

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.modulation.modulators import (
    MODULATORS,
    SIX_STEP_AMPLITUDE,
    sector_waveforms,
)
from dqforge.machines.modulation.registry import DISCONTINUOUS
from dqforge.machines.modulation.ripple import (
    _torque_span,
    flux_moments,
    harmonic_distortion_factor,
    ripple,
    switching_instants,
)
from dqforge.machines.names import ModulationName

CARRIERS, SAMPLES = 360, 1200
SHIFTS = np.array([0.0, 2.0, -2.0]) * math.pi / 3.0


ANGLES: FloatArray = np.linspace(0.0, 2.0 * math.pi, CARRIERS, endpoint=False) + math.pi / CARRIERS
# Both sides of the angles where DPWM1 and DPWM3 change the resting phase:
# there their ripple is largest.
SIDES: FloatArray = np.radians([k * 30.0 + side for k in range(12) for side in (-0.01, 0.01)])


def simulated_flux(
    name: str, amplitude: float, lag: float, angle: FloatArray = ANGLES
) -> FloatArray:
    """Harmonic flux of the phases (N, samples, 3) in v_dc T at voltage angles (N,),
    each carrier period from zero.
    """
    duty = np.array([duties(name, amplitude, float(x), lag) for x in angle])
    carrier = np.abs(2.0 * (np.arange(SAMPLES) + 0.5) / SAMPLES - 1.0)
    states = (duty[:, None, :] > carrier[:, None]).astype(np.float64)
    switched = states - states.mean(axis=-1, keepdims=True)
    wanted = amplitude * np.cos(angle[:, None] - SHIFTS)
    return np.cumsum(switched - wanted[:, None, :], axis=1) / SAMPLES


@pytest.mark.thinned
@pytest.mark.parametrize("name", MODULATORS)
@pytest.mark.parametrize(("index", "degrees"), [(0.2, 10.0), (0.5, -45.0), (0.78, 80.0)])
def test_harmonic_distortion_is_that_of_simulated_switching(
    name: ModulationName, index: float, degrees: float
) -> None:
    flux = simulated_flux(name, index * SIX_STEP_AMPLITUDE, math.radians(degrees))
    square = float(np.mean(flux**2))  # of a phase, over phases and time: half of that of the vector
    found = harmonic_distortion_factor(name, index, math.radians(degrees))
    assert found == pytest.approx(576.0 * square, rel=0.01)


def flux_ripple_square(duty: FloatArray) -> FloatArray:
    """Mean square of the harmonic flux vector over a carrier period (...), in (v_dc T)^2,
    of duty cycles (..., 3).

    The vector is amplitude-invariant: half of its mean square is the mean square of a phase,
    averaged over the phases.
    """
    moments = flux_moments(duty)
    own = np.trace(moments, axis1=-2, axis2=-1)
    return np.asarray((2.0 * own - 2.0 / 3.0 * np.sum(moments, axis=(-2, -1))) / 3.0)


@pytest.mark.parametrize("name", MODULATORS)
@pytest.mark.parametrize("degrees", [0.0, 12.0, -29.0, 45.0, 61.0, -75.0, 89.0, 110.0, 170.0])
def test_closed_form_is_the_average_of_the_carrier_periods(
    name: ModulationName, degrees: float
) -> None:
    """Coefficients of the polynomials against Gauss quadrature of the exact squared
    ripple of each carrier period.
    """
    lag = math.radians(degrees)
    amplitude = np.array([0.05, 0.3, 0.85, 1.0]) * MODULATORS[name].linear_limit
    wave = sector_waveforms(name, amplitude, 0.0, math.cos(lag), -math.sin(lag), 1.0)
    averaged = 288.0 * np.sum(wave.weight * flux_ripple_square(wave.modulation.duty), axis=-1)
    found = harmonic_distortion_factor(name, amplitude / SIX_STEP_AMPLITUDE, lag)
    np.testing.assert_allclose(found, averaged, rtol=1e-9)


def test_known_orders_of_merit() -> None:
    """THIPWM4 has the least ripple of the continuous modulators and DPWM3 of the discontinuous
    ones; with equal commutations DPWM1 is worse than SVPWM at low and better at high voltage (Hava
    1999).
    """
    index = np.linspace(0.05, 0.88, 30)
    factor = {name: harmonic_distortion_factor(name, index) for name in MODULATORS}
    for name in CONTINUOUS:
        assert np.all(factor["thipwm4"] <= factor[name] + 1e-15)
    for name in DISCONTINUOUS - {"dpwm3"}:
        assert np.all(factor["dpwm3"] <= factor[name])
    equal_commutations = factor["dpwm1"] / 1.5**2
    assert equal_commutations[-1] < factor["svpwm"][-1]
    assert equal_commutations[0] > factor["svpwm"][0]
    assert harmonic_distortion_factor("svpwm", 0.0) == 0.0


@pytest.mark.thinned
@pytest.mark.parametrize("name", ["spwm", "svpwm", "dpwm1", "dpwm3", "dpwmmin", "ddt-gdpwm"])
@pytest.mark.parametrize("machine", [IPM, INVERSE_SALIENT], ids=["ipm", "inverse"])
def test_current_and_torque_ripple_of_salient_machines(
    name: ModulationName, machine: LinearMachine
) -> None:
    """The flux of the simulated switching through the two inductances, and T = 3/2 p
    (psi_pm + (l_d - l_q) i_d) i_q.
    """
    i_d, i_q, omega_m, f_sw = -0.4 * machine.i_max, 0.5 * machine.i_max, 150.0, 4e3
    v_d, v_q = (
        float(v)
        for v in machine.voltage(
            np.array(i_d), np.array(i_q), np.array(machine.pole_pairs * omega_m)
        )
    )
    v_dc = 2.2 * math.hypot(v_d, v_q)
    direction = math.atan2(v_q, v_d)
    lag = direction - math.atan2(i_q, i_d)
    found = ripple(name, machine, i_d, i_q, omega_m, v_dc=v_dc, f_sw=f_sw)
    spans = []
    for angle in (SIDES, ANGLES):
        flux = simulated_flux(name, math.hypot(v_d, v_q) / v_dc, lag, angle)
        theta = (angle - direction)[:, None, None] - SHIFTS
        ripple_d = 2.0 / 3.0 * np.sum(flux * np.cos(theta), axis=-1) * v_dc / f_sw / machine.l_d
        ripple_q = -2.0 / 3.0 * np.sum(flux * np.sin(theta), axis=-1) * v_dc / f_sw / machine.l_q
        d, q = i_d + ripple_d, i_q + ripple_q
        torque = 1.5 * machine.pole_pairs * (machine.psi_pm + (machine.l_d - machine.l_q) * d) * q
        spans.append(np.max(np.ptp(torque, axis=1)))
    assert found.i_d == pytest.approx(math.sqrt(np.mean(ripple_d**2)), rel=0.01)
    assert found.i_q == pytest.approx(math.sqrt(np.mean(ripple_q**2)), rel=0.01)
    phase = ripple_d[..., None] * np.cos(theta) - ripple_q[..., None] * np.sin(theta)
    assert found.current == pytest.approx(math.sqrt(np.mean(phase**2)), rel=0.01)
    assert found.torque == pytest.approx(max(spans), rel=0.01)


def test_isotropic_machine_has_the_formula_with_the_distortion_factor() -> None:
    found = ripple("dpwm2", SURFACE, 3.0, 40.0, 100.0, v_dc=120.0, f_sw=8e3)
    v_d, v_q = SURFACE.voltage(np.array(3.0), np.array(40.0), np.array(300.0))
    lag = math.atan2(v_q, v_d) - math.atan2(40.0, 3.0)
    factor = harmonic_distortion_factor(
        "dpwm2", np.hypot(v_d, v_q) / (SIX_STEP_AMPLITUDE * 120.0), lag
    )
    assert found.current == pytest.approx(
        120.0 / (24.0 * SURFACE.l_d * 8e3) * np.sqrt(factor), rel=1e-9
    )


def test_points_are_taken_in_arrays_of_any_shape_and_marked_beyond_the_linear_range() -> None:
    i_q = np.linspace(5.0, 200.0, 3000).reshape(2, 1500)
    found = ripple("gdpwm", IPM, -50.0, i_q, 300.0, v_dc=500.0, f_sw=1e4)
    assert found.torque.shape == (2, 1500)
    for index in ((0, 0), (1, 7), (1, 1499)):
        one = ripple("gdpwm", IPM, -50.0, i_q[index], 300.0, v_dc=500.0, f_sw=1e4)
        for field in ("current", "i_d", "i_q", "torque"):
            assert getattr(one, field) == pytest.approx(getattr(found, field)[index], rel=1e-12)
    beyond = ripple("spwm", IPM, 0.0, 100.0, [100.0, 900.0], v_dc=300.0, f_sw=1e4)
    assert np.isnan(beyond.current).tolist() == [False, True]


def test_saturated_machines_are_linearised_at_their_point() -> None:
    """Where the cross inductance is not zero: mean squares of the simulated flux
    through the inverse matrix.
    """
    machine, i_d, i_q = ArctanMachine(), np.array([-60.0]), np.array([70.0])
    v_d, v_q = (float(v[0]) for v in machine.voltage(i_d, i_q, np.array([300.0])))
    v_dc, f_sw = 2.0 * math.hypot(v_d, v_q), 1e4
    found = ripple("svpwm", machine, i_d, i_q, 100.0, v_dc=v_dc, f_sw=f_sw)
    flux = simulated_flux("svpwm", math.hypot(v_d, v_q) / v_dc, 0.0)
    theta = (ANGLES - math.atan2(v_q, v_d))[:, None, None] - SHIFTS
    flux_dq = (
        2.0
        / 3.0
        * np.stack([np.sum(flux * np.cos(theta), -1), -np.sum(flux * np.sin(theta), -1)])
        * v_dc
        / f_sw
    )
    jet = machine.jet(i_d, i_q)
    matrix = [[jet.l_dd[0], jet.l_dq[0]], [jet.l_qd[0], jet.l_qq[0]]]
    assert abs(jet.l_dq[0]) > 1e-5
    current = np.linalg.solve(np.array(matrix), flux_dq.reshape(2, -1))
    assert found.i_d[0] == pytest.approx(math.sqrt(np.mean(current[0] ** 2)), rel=0.01)
    assert found.i_q[0] == pytest.approx(math.sqrt(np.mean(current[1] ** 2)), rel=0.01)


def test_pulses_are_centred() -> None:
    instants = switching_instants(np.array([0.5, 0.2, 0.0, 1.0, 1.3]), 1e-4)
    expected = [[0.25, 0.75], [0.4, 0.6], [0.5, 0.5], [0.0, 1.0], [0.0, 1.0]]
    np.testing.assert_allclose(instants, 1e-4 * np.array(expected), rtol=1e-14)


def test_the_span_over_a_polygon_is_that_of_many_points_on_it() -> None:
    """Parabolas have their vertex within a piece or beyond it, bent either way, or none."""
    generator = np.random.default_rng(6)
    corners = generator.normal(size=(200, 5, 2))
    corners[:, 4] = -corners[:, 0]  # the mirror image goes on where the polygon ends
    linear, quadratic = generator.normal(size=(200, 2)), generator.normal(size=(200, 2, 2))
    quadratic[::10] = 0.0
    share = np.linspace(0.0, 1.0, 2001)[:, None]
    for row, (line, square) in enumerate(zip(linear, quadratic, strict=True)):
        round_ = np.concatenate([corners[row], -corners[row]])
        points = np.concatenate([a + share * (b - a) for a, b in itertools.pairwise(round_)])
        torque = points @ line + np.einsum("ni,ij,nj->n", points, square, points)
        found = _torque_span(line[None], square[None], corners[row : row + 1])[0]
        assert found == pytest.approx(np.ptp(torque), rel=2e-6)
