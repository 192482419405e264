"""Machines without a magnet, or with a weak one: opposite currents make nearly the same torque."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from saturated import saturated_reluctance, with_drop

from dqforge.machines.arrays import FloatArray
from dqforge.machines.dq_machines.synchronous import LinearMachine, Machine
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus
from dqforge.optimizer.operating_points.points import OptimalPoints, optimal_points

SYRM = LinearMachine(
    pole_pairs=2, r_s=0.0, l_d=0.05, l_q=0.01, psi_pm=0.0, i_max=10.0, inertia=1e-2
)


def drawn(seed: int, axis: str) -> Machine:
    if seed == 0:
        turned = replace(SYRM, l_d=SYRM.l_q, l_q=SYRM.l_d)
        return SYRM if axis == "d" else turned
    return saturated_reluctance(seed, axis)


def solved(
    machine: Machine, seed: int, count: int
) -> tuple[Machine, FloatArray, FloatArray, float, OptimalPoints]:
    """Points to four times the base speed in either direction, with a resistance."""
    generator = np.random.default_rng(100 + seed)
    machine, v_max = with_drop(machine, generator.uniform(0.02, 0.2))
    torque_max = float(mtpa_locus(machine, machine.i_max).torque[-1])
    torque = generator.uniform(0.02, 0.6, count) * torque_max
    omega_m = generator.uniform(-4.0, 4.0, count) * 100.0
    return machine, torque, omega_m, v_max, optimal_points(machine, torque, omega_m, v_max=v_max)


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 5])
def test_a_reluctance_machine_has_the_same_points_whatever_its_axes_are_called(seed: int) -> None:
    """(i_d, i_q) with the greatest inductance on d are (-i_q, i_d) with it on q."""
    _, _, _, _, first = solved(drawn(seed, "d"), seed, 60)
    _, _, _, _, other = solved(drawn(seed, "q"), seed, 60)
    limit = 1e-6 * drawn(seed, "d").i_max
    assert np.count_nonzero(first.active) > 10
    assert np.array_equal(first.active, other.active)
    assert np.max(np.abs(other.i_d + first.i_q)) < limit
    assert np.max(np.abs(other.i_q - first.i_d)) < limit
    assert np.all(other.i_q >= 0.0)


def least_current(
    machine: Machine, torque: FloatArray, omega_e: FloatArray, v_max: float
) -> FloatArray:
    """Least |i| in A for each torque within the voltage, by trying all directions; nan for none."""
    angle, length = np.linspace(-np.pi, np.pi, 721), np.linspace(0.0, machine.i_max, 300)
    i_d, i_q = (length[:, np.newaxis] * part for part in (np.cos(angle), np.sin(angle)))
    made = machine.torque(i_d.ravel(), i_q.ravel()).reshape(i_d.shape)
    found = np.full(torque.size, np.nan)
    for place, (wanted, omega) in enumerate(zip(torque, omega_e, strict=True)):
        row, ray = np.nonzero((made[:-1] <= wanted) != (made[1:] <= wanted))
        share = (wanted - made[row, ray]) / (made[row + 1, ray] - made[row, ray])
        size = length[row] + share * length[1]
        d, q = size * np.cos(angle[ray]), size * np.sin(angle[ray])
        psi_d, psi_q = machine.flux(d, q)
        taken = np.hypot(machine.r_s * d - omega * psi_q, machine.r_s * q + omega * psi_d)
        kept = size[taken <= v_max * (1.0 + 1e-4)]
        if kept.size:
            found[place] = np.min(kept)
    return found


@pytest.mark.parametrize(("seed", "magnet"), [(5, 0.1), (8, 0.2), (14, 0.05), (17, 0.15)])
def test_with_a_weak_magnet_no_direction_takes_less_current(seed: int, magnet: float) -> None:
    drawn_machine = saturated_reluctance(seed, "q", magnet=magnet)
    machine, torque, omega_m, v_max, points = solved(drawn_machine, seed, 60)
    tried = least_current(machine, torque, omega_m * machine.pole_pairs, v_max)
    both = points.reached & np.isfinite(tried)
    assert np.count_nonzero(both & (points.active == 1)) > 5
    assert np.all((np.hypot(points.i_d, points.i_q) <= tried * 1.001)[both])
    assert np.all(np.isnan(tried[~points.reached]))
