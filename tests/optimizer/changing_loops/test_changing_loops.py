"""Current loops whose inductance changes: one Lyapunov function against direct simulation, and the
velocity form that grows though every frozen loop is stable.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.design.settings import CurrentLoopSettings, Tolerances
from dqforge.optimizer.changing_loops import (
    ChangingAxis,
    LoopRange,
    common_matrix_of,
    falls_exactly,
    fastest_growth,
    neighbours_fall,
    parallel_step,
    prove_changing_currents,
    velocity_step,
)
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.loops.integer_gains import inductance_range
from dqforge.optimizer.loops.pi_methods import current_pi
from dqforge.optimizer.loops.robustness import drive_box

R, L, T = 0.4, 2e-3, 1e-4  # Ohm, H, s: the least inductance

SETTINGS = {
    "bandwidth 0.1": CurrentLoopSettings("bandwidth", bandwidth=0.1 / T),
    "bandwidth 0.2": CurrentLoopSettings("bandwidth", bandwidth=0.2 / T),
    "damping": CurrentLoopSettings("damping", bandwidth=0.2 / T, damping=0.7),
    "magnitude": CurrentLoopSettings("magnitude-optimum"),
    "symmetrical": CurrentLoopSettings("symmetrical-optimum", spread=3.0),
}


def gains(settings: CurrentLoopSettings, inductance: float) -> tuple[float, float]:
    """kp and ki t_s in V/A for an inductance."""
    kp, ki = current_pi(R, inductance, T, settings)
    return kp, ki * T


def simulated(inductance: FloatArray, of: FloatArray, form: str) -> FloatArray:
    """Currents after a step of the reference with an inductance and gains (kp, ki t_s) per sample.

    The flux linkage is integrated exactly over each sample; the voltage comes one sample late.
    """
    psi, voltage, integral, before, kp_before = 0.0, 0.0, 0.0, 0.0, of[0, 0]
    currents = []
    for value, (kp, ki_ts) in zip(inductance, of, strict=True):
        current = psi / value
        currents.append(current)
        error = 1.0 - current
        decay = np.exp(-R * T / value)
        psi = decay * psi + (1.0 - decay) / R * value * voltage
        if form == "parallel":
            integral += ki_ts * error
            voltage = kp * error + integral
        elif form == "remedy":
            voltage += kp * error - kp_before * before + ki_ts * error
        else:
            voltage += kp * (error - before) + ki_ts * error
        before, kp_before = error, kp
    return np.array(currents)


@pytest.mark.parametrize("name", SETTINGS)
def test_velocity_form_grows_where_every_frozen_loop_is_stable(name: str) -> None:
    """Inductance and gains 1 : 3 in turn, every sample: 1.2 to 1.3 per sample. The remedy is the
    parallel form, and holds.
    """
    settings, count = SETTINGS[name], 120
    inductance = np.where(np.arange(count) % 2 == 0, L, 3.0 * L)
    of = np.array([gains(settings, float(value)) for value in inductance])
    for value in (L, 3.0 * L):
        frozen = np.tile(gains(settings, value), (4000, 1))
        assert abs(simulated(np.full(4000, value), frozen, "velocity")[-1] - 1.0) < 0.01
    steps = []
    for value in (L, 3.0 * L):
        decay = np.exp(-R * T / value)
        share = (1.0 - decay) / (R * T / value)
        steps.append(velocity_step(decay, share, T / value, gains(settings, value)))
    growth = fastest_growth(np.array(steps))
    assert growth is not None
    assert 1.18 < growth.factor < 1.3
    assert growth.stay == 1
    grown = np.abs(simulated(inductance, of, "velocity"))
    tail = np.log(np.max(grown[-10:]) / np.max(grown[-50:-40])) / 40.0
    assert np.exp(tail) == pytest.approx(growth.factor, rel=1e-3)
    longer = np.tile(inductance, 40)
    many = np.tile(of, (40, 1))
    remedied = simulated(longer, many, "remedy")
    assert remedied == pytest.approx(simulated(longer, many, "parallel"), abs=1e-9)
    assert np.max(np.abs(remedied)) < 3.0


def scheduled_range(settings: CurrentLoopSettings, most: float) -> LoopRange:
    """Gains that follow inductances from L to ``most`` L exactly."""
    values = np.geomspace(L, most * L, 50)
    pairs = np.array([gains(settings, float(value)) for value in values]) * T / values[:, None]
    sides = [(float(of.min()), float(of.max())) for of in pairs.T]
    products = tuple((p, q) for p in sides[0] for q in sides[1])
    return LoopRange((0.7 * R * T / (most * L), 1.6 * R * T / L), products)


@pytest.mark.parametrize("name", SETTINGS)
def test_one_function_serves_scheduled_gains_in_parallel_form(name: str) -> None:
    """For inductances from 1 to 40, and random courses of the inductance never grow in its norm."""
    loops = scheduled_range(SETTINGS[name], 40.0)
    matrix = common_matrix_of(loops)
    assert matrix is not None
    generator, state = np.random.default_rng(3), np.array([1.0, -0.5, 0.3])
    for _ in range(400):
        rho = generator.uniform(*loops.rho)
        p, q = loops.products[int(generator.integers(len(loops.products)))]
        step = np.array(parallel_step(np.exp(-rho), -np.expm1(-rho) / rho, p, q))
        after = step @ state
        assert after @ matrix @ after < state @ matrix @ state
        state = after / np.linalg.norm(after)


def constant_range(settings: CurrentLoopSettings, most: float) -> LoopRange:
    kp, ki_ts = gains(settings, L)
    products = tuple((kp * T / (L * x), ki_ts * T / (L * x)) for x in (1.0, most))
    return LoopRange((0.7 * R * T / (most * L), 1.6 * R * T / L), products)


@pytest.mark.parametrize("name", SETTINGS)
def test_constant_gains_have_one_function_up_to_a_limit(name: str) -> None:
    """Where one is not found, pieces that follow each other reach further."""
    settings = SETTINGS[name]
    limits = [
        x
        for x in (2.0, 3.0, 4.0, 6.0, 10.0, 20.0, 60.0)
        if common_matrix_of(constant_range(settings, x)) is not None
    ]
    assert limits[:2] == [2.0, 3.0]
    assert limits[-1] < 60.0
    beyond = constant_range(settings, 10.0)
    ends = np.geomspace(1.0, 10.0, 17)
    pieces = []
    for low, high in pairwise(ends):
        (p, q), _ = beyond.products
        of = ((p / low, q / low), (p / high, q / high))
        pieces.append(LoopRange(beyond.rho, of).corners())
    assert neighbours_fall(pieces)
    assert not neighbours_fall([1.3 * piece for piece in pieces])


def test_a_matrix_is_judged_exactly() -> None:
    corners = constant_range(SETTINGS["bandwidth 0.2"], 3.0).corners()
    matrix = common_matrix_of(constant_range(SETTINGS["bandwidth 0.2"], 3.0))
    assert matrix is not None
    assert falls_exactly(matrix, corners)
    assert not falls_exactly(-matrix, corners)
    assert not falls_exactly(np.eye(3), corners)
    assert not falls_exactly(matrix, 1.1 * corners)
    indefinite = matrix - 1.01 * np.linalg.eigvalsh(matrix)[0] * np.eye(3)
    assert not falls_exactly(indefinite, corners)


def test_sampled_winding_lies_in_its_intervals() -> None:
    alpha, beta = LoopRange((-0.01, 0.3), ((0.1, 0.1),)).shares()
    for rho in (-0.01, -1e-9, 0.0, 1e-6, 0.1, 0.3):
        share = 1.0 if rho == 0.0 else -np.expm1(-rho) / rho
        assert alpha[0] <= np.exp(-rho) <= alpha[1]
        assert beta[0] <= share <= beta[1]


@cache
def changing(
    method: str, schedule: bool, tolerances: Tolerances | None = None
) -> tuple[tuple[ChangingAxis, ...], GainSet]:
    made = catalogue.load("baldor-pmsyrm-5k6")
    current = CurrentLoopSettings(method, bandwidth=1500.0, spread=3.0, schedule=schedule)  # type: ignore[arg-type]
    control = replace(
        made.control, current_loop=current, speed_loop=None, observer=None, tolerances=tolerances
    )
    design = replace(made, control=control)
    found = solve_gains(design)
    nominal, largest = inductance_range(design.machine, design.i_max)
    box = drive_box(design, nominal, largest)
    return prove_changing_currents(box, largest, (found.i_d, found.i_q), found.schedule), found


def test_a_machine_that_saturates() -> None:
    (of_d, of_q), found = changing("bandwidth", schedule=True)
    assert found.proofs.changing == (of_d, of_q)
    assert of_d.proven
    assert of_q.proven
    assert of_d.any_current
    assert not of_q.any_current
    assert of_q.inductance[1] / of_q.inductance[0] > 4.0
    assert of_q.velocity is not None
    growth, currents = of_q.velocity
    assert growth.factor > 1.3
    assert currents[0] < 0.1 * currents[1]
    (constant, _), _ = changing("bandwidth", schedule=False)
    assert constant.proven
    assert constant.any_current is None
    assert constant.velocity is None


def test_what_one_function_does_not_serve_is_proven_up_to_a_rate() -> None:
    """Damping chooses an integral gain that is large for the largest inductance."""
    (_, of_q), _ = changing("damping", schedule=False)
    assert not of_q.proven
    assert of_q.rate is not None
    assert 1.05 < of_q.rate < of_q.inductance[1] / of_q.inductance[0]


@pytest.mark.slow
def test_tolerances_are_cut_where_one_function_does_not_serve_all() -> None:
    wide = Tolerances(r_s=0.3, l_d=0.2, l_q=0.2, v_dc=0.1)
    (_, of_q), _ = changing("symmetrical-optimum", schedule=False, tolerances=wide)
    assert of_q.proven
    assert of_q.cells > 1


def test_a_linear_machine_has_nothing_that_changes() -> None:
    design = catalogue.load("abb-ipmsm-2k2")
    assert solve_gains(design).proofs.changing == ()
