"""The estimation of resistance and magnet flux: against a simulation of the dq equations written
here, and what is judged of it against closed forms.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drives import INVERSE_SALIENT, SURFACE, make_design

from dqforge.machines.design.catalogue import load_text, read_text
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import OnlineEstimationSettings, Tolerances
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import InputError
from dqforge.optimizer.online_estimation import (
    FLUX,
    FLUX_WRONG,
    INDUCTANCE_WRONG,
    RESISTANCE,
    RESISTANCE_WRONG,
    SENSOR_WRONG,
    Estimability,
    OnlineEstimation,
    OperatingSamples,
    Sought,
    _acting,
    _bounded,
    at_rest,
    estimability,
    gains_of,
    left_of_dead_time,
    solve_online_estimation,
    sought_of,
    start,
    step,
)
from dqforge.optimizer.steps.step_arithmetic import EXACT, AlphaBeta

T_S, TAU = 1e-4, 0.05
one: Any = np.float64
BOTH = Sought(flux=True, resistance=True, dead_time=False)


def asked(machine: LinearMachine, dead_time: float = 0.0, **wanted: float) -> Design:
    design = make_design(machine)
    settings = OnlineEstimationSettings(time_constant=wanted.get("tau", TAU))
    control = replace(design.control, t_s=T_S, online_estimation=settings)
    inverter = replace(design.inverter, dead_time=dead_time, f_sw=1e4)
    return replace(design, control=control, inverter=inverter)


def held(
    machine: LinearMachine, i_d: float, i_q: float, omega: float, count: int, substeps: int = 20
) -> list[tuple[AlphaBeta, AlphaBeta, Any]]:
    """Samples (voltage over the period before, current, angle) of a machine whose currents a plain
    proportional-integral control holds about a reference; its dq equations by small Euler steps,
    under voltages that rest in stationary coordinates.
    """
    id_, iq, theta, h = 0.0, 0.0, 0.3, T_S / substeps
    sums, waiting, rows = np.zeros(2), 0j, []
    for _ in range(count):
        i = (id_ + 1j * iq) * np.exp(1j * theta)
        acted = waiting
        rows.append((acted, i, theta))
        error = np.array([i_d - id_, i_q - iq])
        sums = sums + 300.0 * machine.r_s * error * T_S
        wanted = sums + 300.0 * np.array([machine.l_d, machine.l_q]) * error
        v_d = wanted[0] - omega * machine.l_q * iq
        v_q = wanted[1] + omega * (machine.l_d * id_ + machine.psi_pm)
        waiting = (v_d + 1j * v_q) * np.exp(1j * (theta + 0.5 * omega * T_S))
        for _ in range(substeps):
            v = waiting * np.exp(-1j * (theta + 0.5 * omega * h))
            slope_d = (v.real - machine.r_s * id_ + omega * machine.l_q * iq) / machine.l_d
            slope_q = v.imag - machine.r_s * iq - omega * (machine.l_d * id_ + machine.psi_pm)
            id_, iq = id_ + h * slope_d, iq + h * slope_q / machine.l_q
            theta += h * omega
    return [
        (AlphaBeta(one(v.real), one(v.imag)), AlphaBeta(one(i.real), one(i.imag)), one(angle))
        for v, i, angle in rows
    ]  # fmt: skip


def estimates(
    known: LinearMachine, true: LinearMachine, i_d: float, i_q: float, omega: float, count: int
) -> OnlineEstimation:
    """The state after so many samples of another machine than the known one."""
    gains, state = gains_of(asked(known)), at_rest()
    start(EXACT, gains, state)
    for v, i, theta in held(true, i_d, i_q, omega, count):
        step(BOTH, EXACT, gains, state, v, i, theta, one(omega))
    return state


# Per case: currents in A, electrical speed in rad/s, and what the operating point shows.
@pytest.mark.parametrize(
    ("i_d", "i_q", "omega", "status"),
    [
        (0.0, 20.0, 15.0, RESISTANCE),
        (-10.0, -20.0, -15.0, RESISTANCE),
        (12.0, 0.0, 0.0, RESISTANCE),
        (0.0, 2.0, 1500.0, FLUX),
        (-5.0, 6.0, -1500.0, FLUX),
        (-30.0, 2.0, 400.0, RESISTANCE | FLUX),
        (0.0, 10.0, 30.0, 0),
    ],
)
def test_what_the_point_shows_is_found_in_a_simulated_machine(
    i_d: float, i_q: float, omega: float, status: int
) -> None:
    known = INVERSE_SALIENT
    true = replace(
        known,
        r_s=known.r_s * (1.25 if status & RESISTANCE else 1.0),
        psi_pm=known.psi_pm * (0.9 if status & FLUX else 1.0),
    )
    found = estimates(known, true, i_d, i_q, omega, 6000)
    assert found.status == status
    assert found.r_s == pytest.approx(true.r_s, rel=4e-3)
    assert found.psi_pm == pytest.approx(true.psi_pm, rel=2e-3)


def test_estimates_follow_with_their_time_constant() -> None:
    known = SURFACE
    true = replace(known, r_s=1.2 * known.r_s)
    first, second, third = (
        float(estimates(known, true, 0.0, 20.0, 10.0, count).r_s) for count in (1000, 1500, 2000)
    )
    decay = np.log((second - first) / (third - second))
    assert decay == pytest.approx(500 * T_S / TAU, rel=0.01)


def test_estimates_stay_within_what_copper_and_magnets_can_be() -> None:
    known = SURFACE
    hot = replace(known, r_s=3.0 * known.r_s)
    assert estimates(known, hot, 0.0, 20.0, 0.0, 3000).r_s == pytest.approx(1.6288 * known.r_s)
    weak = replace(known, psi_pm=0.4 * known.psi_pm)
    assert estimates(known, weak, 0.0, 0.0, 1000.0, 3000).psi_pm == pytest.approx(
        0.68 * known.psi_pm
    )


def test_what_is_no_number_leaves_the_estimates() -> None:
    gains, state = gains_of(asked(SURFACE)), at_rest()
    start(EXACT, gains, state)
    nothing = one(np.nan)
    for v, i, theta in held(SURFACE, 0.0, 20.0, 0.0, 50):
        step(BOTH, EXACT, gains, state, v, i, theta, one(0.0))
    before = float(state.r_s)
    for bad in (AlphaBeta(nothing, nothing), AlphaBeta(one(np.inf), nothing)):
        step(BOTH, EXACT, gains, state, bad, i, theta, one(0.0))
    assert float(state.r_s) == pytest.approx(before, rel=1e-3)


def test_a_dead_time_takes_a_trapezoid_of_each_phase() -> None:
    """Of the mean of two samples, whole from the crossing on, to either side."""
    design = asked(INVERSE_SALIENT, dead_time=1e-6)
    gains, sought = gains_of(design), sought_of(design)
    assert sought.dead_time
    phase = np.linspace(-3.0, 3.0, 25)
    size = np.resize([0.02, 0.4, 1.7, 60.0], 25) / gains.per_ampere
    i = size * np.exp(1j * phase)
    both, v = AlphaBeta(2.0 * i.real, 2.0 * i.imag), AlphaBeta(np.cos(phase), 3.0 + phase)
    found = _acting(sought, EXACT, gains, v, both)
    turn = np.exp(2j * np.pi / 3.0)
    legs = [np.clip((i * turn**-k).real * gains.per_ampere, -1.0, 1.0) * turn**k for k in range(3)]
    taken = gains.dead * 2.0 / 3.0 * np.sum(legs, axis=0)
    np.testing.assert_allclose(found.alpha + 1j * found.beta, v.alpha + 1j * v.beta - taken)
    # the fundamental of a square wave is 4/pi of its height
    lost = 4.0 / np.pi * 1e4 * design.inverter.v_dc * 1e-6
    assert 4.0 / np.pi * gains.dead == pytest.approx(lost)
    plain = replace(sought, dead_time=False)
    assert _acting(plain, EXACT, gains, v, both) is v


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_single_sample_moves_an_estimate_by_a_share_of_ten_times_its_largest(
    sign: float,
) -> None:
    gains = gains_of(asked(INVERSE_SALIENT))
    gap = np.array([0.3, 9.0, 11.0, 1e9, np.nan]) * 0.4
    found = _bounded(EXACT, sign * gap, np.array(0.4))
    assert found == pytest.approx(sign * np.array([0.12, 3.6, 4.0, 4.0, 0.0]))
    state, before = at_rest(), gains.r_s
    start(EXACT, gains, state)
    current, v = AlphaBeta(one(0.0), one(20.0)), AlphaBeta(one(0.0), one(sign * 1e9))
    for _ in range(2):
        step(BOTH, EXACT, gains, state, v, current, one(0.0), one(0.0))
    limit = gains.r_most if sign > 0.0 else gains.r_least
    moved = before + sign * gains.share * 10.0 * gains.r_most
    assert state.r_s == pytest.approx(np.clip(moved, gains.r_least, gains.r_most))
    for _ in range(200):
        step(BOTH, EXACT, gains, state, v, current, one(0.0), one(0.0))
    assert state.r_s == pytest.approx(limit)


def judged(machine: LinearMachine, design: Design, *points: tuple[float, ...]) -> Estimability:
    at = OperatingSamples(*np.array(points, dtype=np.float64).T)
    left = left_of_dead_time(design)
    return estimability(machine, T_S, gains_of(design), sought_of(design), at, left)


def test_the_errors_decay_as_the_equations_say() -> None:
    """Of x = (R, psi), dx/dt = -((1, omega i_q/i^2), (i_q/omega, 1)) x/tau where both are seen."""
    machine = INVERSE_SALIENT
    i_d, i_q, omega = -30.0, 2.0, 300.0
    seen = judged(machine, asked(machine), (i_d, i_q, omega), (0.0, 30.0, 5.0), (0.0, 0.0, 1500.0))
    assert seen.status.tolist() == [RESISTANCE | FLUX, RESISTANCE, FLUX]
    square = i_d**2 + i_q**2
    matrix = -np.array([[1.0, omega * i_q / square], [i_q / omega, 1.0]]) / TAU
    assert np.sort(seen.poles[0]) == pytest.approx(np.sort(np.linalg.eigvals(matrix)), rel=2e-3)
    assert np.sort(seen.poles[1]) == pytest.approx([-1.0 / TAU, 0.0], rel=2e-3)
    assert seen.settling[1:] == pytest.approx(TAU, rel=2e-3)


def test_what_is_wrong_shifts_the_estimates_as_closed_forms_say() -> None:
    machine, lost = INVERSE_SALIENT, 0.4e-6
    design = asked(machine, dead_time=lost)
    low, fast = (-12.0, 30.0, 4.0), (-6.0, 10.0, 1200.0)
    seen = judged(machine, design, low, fast)
    assert seen.status.tolist() == [RESISTANCE, FLUX]
    left = 0.2 * 4.0 / np.pi * 1e4 * design.inverter.v_dc * lost
    assert left_of_dead_time(design) == pytest.approx(left)
    r_s, psi, l_d, l_q = machine.r_s, machine.psi_pm, machine.l_d, machine.l_q
    i_d, i_q, omega = low
    square = i_d**2 + i_q**2
    for cause, shift in (
        ("dead_time", left / np.sqrt(square)),
        ("l_d", omega * INDUCTANCE_WRONG * l_d * i_d * i_q / square),
        ("l_q", -omega * INDUCTANCE_WRONG * l_q * i_d * i_q / square),
        ("sensor", -SENSOR_WRONG * (r_s + omega * (l_d - l_q) * i_d * i_q / square)),
        ("psi_pm", omega * FLUX_WRONG * psi * i_q / square),
    ):
        assert seen.shifts[cause][0, 0] * r_s == pytest.approx(shift, rel=0.03, abs=1e-5), cause
        assert np.isnan(seen.shifts[cause][0, 1])
    i_d, i_q, omega = fast
    for cause, shift in (
        ("dead_time", left * i_q / np.hypot(i_d, i_q) / omega),
        ("l_d", INDUCTANCE_WRONG * l_d * i_d),
        ("l_q", 0.0),
        ("sensor", -SENSOR_WRONG * (l_d * i_d + r_s * i_q / omega)),
        ("r_s", RESISTANCE_WRONG * r_s * i_q / omega),
    ):
        assert seen.shifts[cause][1, 1] * psi == pytest.approx(shift, rel=0.04, abs=2e-5), cause


def test_a_compensated_dead_time_is_not_taken_away_again() -> None:
    design = asked(SURFACE, dead_time=2e-6)
    assert sought_of(design).dead_time
    limits = Tolerances(dead_time=0.1e-6, low_current=1.0)
    told = replace(design, control=replace(design.control, tolerances=limits))
    assert not sought_of(told).dead_time
    assert left_of_dead_time(told) == pytest.approx(0.1e-6 * design.inverter.lost_per_dead_time)


def test_the_points_of_a_design_keep_its_voltage() -> None:
    design = asked(INVERSE_SALIENT)
    found = solve_online_estimation(design)
    assert found is not None
    machine, at = INVERSE_SALIENT, found.points
    v_d = machine.r_s * at.i_d - at.omega_e * machine.l_q * at.i_q
    v_q = machine.r_s * at.i_q + at.omega_e * (machine.l_d * at.i_d + machine.psi_pm)
    assert np.max(np.hypot(v_d, v_q)) <= design.v_max
    assert len(at.omega_e) == len(found.torque) > 5
    assert solve_online_estimation(make_design()) is None


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ("{flux: false, resistance: false}", "neither flux nor resistance"),
        ("{time_constant: 1 ms}", "time_constant"),
    ],
)
def test_what_makes_no_sense_is_refused(keys: str, said: str) -> None:
    text = read_text("paper001-pmsm-bench").decode("utf-8")
    text = text.replace("  per_unit:\n", f"  online_estimation: {keys}\n  per_unit:\n")
    with pytest.raises(InputError, match=said):
        load_text(text.encode(), "bench.yaml")
