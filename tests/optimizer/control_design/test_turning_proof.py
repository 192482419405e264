"""The proof of a design's current loops: its box is that of the tolerances, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import make_design

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import CurrentLoopSettings, Tolerances
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.certificates.cell_queue import (
    BoxDrive,
    largest_moduli,
    loop_matrices,
    parameters_of,
)
from dqforge.optimizer.control_design.gain_set import (
    GainSet,
    current_loop_box,
    solve_gains,
    turning_proof,
)
from dqforge.optimizer.loops.robustness import DriveBox, drive_box

MACHINE = LinearMachine(
    pole_pairs=3, r_s=2.35, l_d=1.61e-3, l_q=1.74e-3, psi_pm=0.06, i_max=6.4, inertia=2e-4,
    omega_m_max=500.0,
)  # fmt: skip

TOLERANCES = Tolerances(
    r_s=(-0.1, 0.4), l_d=0.2, l_q=(-0.25, 0.1), v_dc=(-0.1, 0.05), dead_time=(-0.2e-6, 0.3e-6),
    low_current=0.8,
)  # fmt: skip


def design(tolerances: Tolerances | None = TOLERANCES) -> Design:
    made = make_design(MACHINE)
    control = replace(
        made.control,
        t_s=2e-4,
        current_loop=CurrentLoopSettings("bandwidth", bandwidth=1200.0),
        speed_loop=None,
        observer=None,
        tolerances=tolerances,
    )
    return replace(made, control=control, inverter=replace(made.inverter, v_dc=180.0, f_sw=5e3))


def box_of(made: Design) -> DriveBox:
    own = (made.machine.l_d, made.machine.l_q)
    return drive_box(made, own, own)


def loops(made: Design) -> GainSet:
    """Gains without tolerances: nothing is checked over them."""
    return solve_gains(replace(made, control=replace(made.control, tolerances=None)))


def test_the_box_is_that_of_the_tolerances_and_its_model_that_of_the_corners() -> None:
    """Every corner that `turning_machines` tries lies in the box and has the same poles."""
    from dqforge.optimizer.loops.integer_gains import CurrentControl, largest_pole

    made = design()
    box, gains = box_of(made), loops(made)
    inputs = current_loop_box(box, gains.i_d, gains.i_q)
    assert inputs is not None
    assert inputs.omega_e == 1500.0
    assert inputs.r_s == pytest.approx((0.9 * 2.35, 1.4 * 2.35))
    assert inputs.l_q == pytest.approx((0.75 * 1.74e-3, 1.1 * 1.74e-3))
    assert inputs.gain == pytest.approx((0.9, 1.05))
    points = box.turning_points()
    machines = box.turning_machines(points, np.array([0.0, 700.0, 1500.0]))
    control = CurrentControl(
        inputs.kp, inputs.ki_ts, *inputs.decoupling, advance=1.5 * 2e-4, t_s=2e-4
    )
    rows = zip(
        machines.r_s, machines.l_d, machines.l_q, machines.gain, machines.omega_e, strict=True
    )
    drives = [BoxDrive(*row) for row in rows]
    for drive in drives:
        for value, (low, high) in (
            (drive.l_d, inputs.l_d),
            (drive.l_q, inputs.l_q),
            (drive.gain, inputs.gain),
        ):
            assert low * (1 - 1e-12) <= value <= high * (1 + 1e-12)
        ends = [r + c * drive.gain for r, c in zip(inputs.r_s, inputs.dead_time, strict=True)]
        assert ends[0] * (1 - 1e-12) <= drive.r_s <= ends[1] * (1 + 1e-12)
    matrices = loop_matrices(inputs, np.array([parameters_of(inputs, drive) for drive in drives]))
    np.testing.assert_allclose(
        largest_moduli(matrices), largest_pole(machines, control), atol=1e-11
    )


@pytest.mark.slow
def test_a_design_with_tolerances_is_proven_with_its_sensitivity() -> None:
    robust = solve_gains(design()).robust
    assert robust is not None
    proof = robust.proof
    assert proof is not None
    assert proof.proven
    assert proof.sensitivity is not None
    assert proof.sensitivity.bound is not None
    assert proof.sensitivity.found < proof.sensitivity.bound <= 1.1 * proof.sensitivity.found


def test_a_drive_that_is_unstable_refuses_the_design_by_name() -> None:
    made = design()
    gains = loops(made)
    i_d, i_q = (replace(loop, kp=4.0 * loop.kp) for loop in (gains.i_d, gains.i_q))
    with pytest.raises(NoSolutionError) as caught:
        turning_proof(box_of(made), i_d, i_q)
    text = caught.value.message
    assert "both current loops together are unstable at" in text
    assert "rpm" in text
    assert "l_q -25 %" in text
    assert "v_dc +5 %" in text


@pytest.mark.slow
def test_without_a_largest_speed_nothing_is_proven() -> None:
    made = design()
    slow = replace(made, machine=replace(MACHINE, omega_m_max=None))
    robust = solve_gains(slow).robust
    assert robust is not None
    assert robust.proof is None
    assert robust.turning is None


@pytest.mark.slow
def test_saturation_widens_the_box_of_constant_gains() -> None:
    saturated = catalogue.load("baldor-pmsyrm-5k6")
    control = replace(
        saturated.control, speed_loop=None, observer=None, tolerances=Tolerances(r_s=0.1, l_d=0.1)
    )
    gains = solve_gains(replace(saturated, control=control))
    assert gains.robust is not None
    proof = gains.robust.proof
    assert proof is not None
    assert proof.box.l_q[1] > 1.2 * proof.box.l_q[0]
    assert proof.box.l_d[1] > 1.2 / 0.9 * proof.box.l_d[0]
