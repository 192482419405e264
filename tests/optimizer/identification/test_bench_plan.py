"""The plan of a bench: its points, and the intervals that it promises, against drawn benches."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.identification.bench_plan import plan_bench

KEYS = ("resistance", "magnet_flux", "inductance_d", "inductance_q")


def test_drawn_benches_scatter_as_the_plan_says() -> None:
    """Least squares of u_d and u_q over the points, written here, on 400 drawn benches."""
    design = catalogue.load("abb-ipmsm-2k2")
    plan = plan_bench(design)
    machine = linearised(design.machine)
    omega, i_d, i_q = (
        np.array([getattr(point, name) for point in plan.points])
        for name in ("omega_m", "i_d", "i_q")
    )
    omega = omega * machine.pole_pairs
    size = np.hypot(np.hypot(i_d, i_q), 0.02 * np.max(np.hypot(i_d, i_q)))
    zero, one = np.zeros_like(i_d), np.ones_like(i_d)
    upper = [i_q, omega, omega * np.abs(i_q), i_q / size, one, omega * i_d, zero, zero]
    lower = [i_d, zero, zero, i_d / size, zero, zero, -omega * i_q, one]
    columns = np.concatenate([np.column_stack(upper), np.column_stack(lower)])
    truth = [machine.r_s, machine.psi_pm, 0.0, 3.0, 0.0, machine.l_d, machine.l_q, 0.0]
    random = np.random.default_rng(34)
    noise = random.normal(0.0, plan.noise, (columns.shape[0], 400))
    found = np.linalg.lstsq(columns, (columns @ truth)[:, None] + noise, rcond=None)[0]
    places = dict(zip(KEYS, (0, 1, 5, 6), strict=True))
    halves = {one.key: one.half for one in plan.expected}
    for key, place in places.items():
        assert np.std(found[place]) == pytest.approx(halves[key] / 1.96, rel=0.12), key
    at = catalogue.load("abb-ipmsm-2k2").i_max
    angle = np.linspace(0.5, 1.0, 501) * np.pi
    d, q = at * np.cos(angle), at * np.sin(angle)
    best = int(np.argmax(design.machine.torque(d, q)))
    made = found[1] * q[best] + (found[5] - found[6]) * d[best] * q[best]
    assert 1.96 * np.std(made) / np.mean(made) == pytest.approx(plan.torque, rel=0.12)


def test_each_point_has_its_mirror_image_and_both_directions_within_the_voltage() -> None:
    design = catalogue.load("paper000-ipmsm-100kw")
    plan = plan_bench(design)
    assert plan.left_out > 0
    points = {(round(p.omega_m, 6), round(p.i_d, 6), round(p.i_q, 6)) for p in plan.points}
    machine = linearised(design.machine)
    for omega, i_d, i_q in points:
        mirrored = [(-omega, i_d, i_q), (omega, i_d, -i_q)]
        u = [
            np.hypot(
                machine.r_s * d - machine.pole_pairs * w * machine.l_q * q,
                machine.r_s * q + machine.pole_pairs * w * (machine.psi_pm + machine.l_d * d),
            )
            for w, d, q in mirrored
        ]
        for place, voltage in zip(mirrored, u, strict=True):
            assert place in points or voltage > 0.95 * design.v_max * (1.0 - 1e-9)
    count = len(plan.points)
    for share, least in plan.least_points.items():
        assert least == max(18, int(np.ceil(count * (plan.torque / share) ** 2)))
    # The grid by hand, in the order of the bench, and what of it the voltage permits.
    base = design.v_max / (machine.pole_pairs * machine.psi_pm)
    wanted = [
        (
            way * share * base,
            -size * design.i_max * np.sin(a),
            sign * size * design.i_max * np.cos(a),
        )
        for size in (1.0, 0.25, 0.75, 0.5)
        for a in np.radians([0.0, 35.0, 70.0])
        for share in (0.3, 0.6)
        for way in (1.0, -1.0)
        for sign in (1.0, -1.0)
    ]
    assert plan.left_out == len(wanted) - count
    kept = []
    for w, d, q in wanted:
        u_d = machine.r_s * d - machine.pole_pairs * w * machine.l_q * q
        u_q = machine.r_s * q + machine.pole_pairs * w * (machine.psi_pm + machine.l_d * d)
        if np.hypot(u_d, u_q) <= 0.95 * design.v_max:
            kept.append((w, d, q))
    found = [(point.omega_m, point.i_d, point.i_q) for point in plan.points]
    np.testing.assert_allclose(found, kept, rtol=1e-9, atol=1e-9)
    assert plan.noise == pytest.approx(0.003 * design.v_max)
    known = {one.key: one.value for one in plan.expected}
    lost = 4.0 / np.pi * design.inverter.f_sw * design.inverter.v_dc * design.inverter.dead_time
    own = [machine.r_s, machine.psi_pm, machine.l_d, machine.l_q, lost]
    keys = (*KEYS, "inverter_voltage")
    assert {key: known[key] for key in keys} == pytest.approx(dict(zip(keys, own, strict=True)))


def test_a_link_that_leaves_too_few_points_is_refused() -> None:
    design = catalogue.load("paper000-ipmsm-100kw")
    small = replace(design, inverter=replace(design.inverter, v_dc=0.2))
    with pytest.raises(NoSolutionError, match=r"of 96 points only [0-7] lie within"):
        plan_bench(small)


def test_a_machine_without_magnets_has_no_plan() -> None:
    with pytest.raises(NoSolutionError, match="this machine has none"):
        plan_bench(catalogue.load("abb-syrm-6k7"))
