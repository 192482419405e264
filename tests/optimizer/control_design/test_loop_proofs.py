"""What is proven of a design's single loops: found from its tolerances, refused, left out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from drives import INVERSE_SALIENT, SURFACE, make_design

from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import (
    CurrentLoopSettings,
    ObserverSettings,
    SpeedLoopSettings,
    Tolerances,
)
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.errors import NoSolutionError
from dqforge.optimizer.control_design import gain_set as loop_proofs
from dqforge.optimizer.control_design.gain_set import GainSet, solve_gains
from dqforge.optimizer.loops.integer_gains import inductance_range
from dqforge.optimizer.loops.pi_methods import close_loops
from dqforge.optimizer.loops.robustness import DriveBox, drive_box
from dqforge.optimizer.speed_box import prove_speed_loop, speed_box, speed_numbers

TOLERANCES = Tolerances(
    r_s=0.3,
    l_d=0.2,
    l_q=0.25,
    v_dc=0.1,
    psi_pm=0.05,
    inertia=0.2,
    dead_time=0.1e-6,
    low_current=20.0,
)


def design(machine: LinearMachine, tolerances: Tolerances | None, ratio: int = 4) -> Design:
    made = make_design(replace(machine, inertia=2e-4, friction=4e-5))
    control = replace(
        made.control,
        t_s=1e-4,
        current_loop=CurrentLoopSettings("bandwidth", bandwidth=600.0),
        speed_loop=SpeedLoopSettings(
            "symmetrical-optimum", ratio=ratio, spread=6.0, min_phase_margin=0.1
        ),
        observer=None,
        tolerances=tolerances,
    )
    return replace(made, control=control, inverter=replace(made.inverter, f_sw=10e3))


def solved(made: Design) -> tuple[DriveBox, GainSet]:
    return drive_box(made, *inductance_range(made.machine, made.i_max)), solve_gains(made)


@pytest.mark.slow
@pytest.mark.parametrize("machine", [SURFACE, INVERSE_SALIENT])
def test_the_proof_is_about_the_same_poles_as_corners_and_samples(machine: LinearMachine) -> None:
    """Each corner and sample, at no load and at full current, in the parameters of the proof;
    without friction, part of which is in its remainder.
    """
    made = design(machine, TOLERANCES)
    box, gains = solved(replace(made, machine=replace(machine, inertia=2e-4, friction=0.0)))
    assert gains.speed is not None
    points = box.speed_points()
    plants = box.speed_loop_plants(points, (gains.i_q.kp, gains.i_q.ki))
    expected = close_loops(plants, gains.speed.kp, gains.speed.ki).radius
    drives = speed_box(box)
    loop = speed_numbers(box, drives, gains.speed, gains.i_q)
    g, inductance = 1.0 + points.of("v_dc"), 1.0 + points.of("l_q")
    emf = machine.pole_pairs * machine.psi_pm * points.of("psi_pm")
    parameters = np.stack(
        [
            g / inductance,
            box.resistance(points) / machine.r_s / inductance,
            box.torque_factor(points) / (1.0 + points.of("inertia")),
            emf / g,
        ],
        axis=1,
    )
    root = drives.root()
    assert np.all((parameters >= root.low) & (parameters <= root.high))
    steps = loop.steps(parameters)
    radii = [np.max(np.abs(np.linalg.eigvals(loop.cycle(step)))) for step in steps]
    assert radii == pytest.approx(expected, abs=1e-9)


def test_all_loops_of_a_design_are_proven() -> None:
    _, gains = solved(design(SURFACE, TOLERANCES))
    assert set(gains.proofs.margins) == {"i_d", "i_q"}
    assert all(proven.stable for proven in gains.proofs.margins.values())
    speed = gains.proofs.speed
    assert speed is not None
    assert speed.complete
    assert (speed.share, speed.ratio) == (1.0, 4)
    assert speed.leaves >= 1


def test_without_tolerances_nothing_is_proven() -> None:
    _, gains = solved(design(SURFACE, None))
    assert gains.proofs == loop_proofs.LoopProofs()


@pytest.mark.slow
def test_a_speed_from_an_observer_is_left_out() -> None:
    made = design(SURFACE, TOLERANCES)
    control = replace(made.control, observer=ObserverSettings(pole=2000.0))
    gains = solve_gains(replace(made, control=control))
    assert gains.proofs.observed
    assert gains.proofs.speed is None
    assert gains.proofs.margins


@pytest.mark.slow
def test_effort_that_ends_states_a_share() -> None:
    """A long cycle is not tried by every run; the share is that of random drives."""
    box, gains = solved(design(SURFACE, TOLERANCES, ratio=50))
    assert gains.speed is not None
    proof = gains.proofs.speed
    assert proof is not None
    assert (proof.cells, proof.share, proof.complete) == (0, 0.0, False)
    again = prove_speed_loop(box, gains.speed, gains.i_q)
    assert again.share == proof.share


@pytest.mark.slow
def test_a_drive_between_the_corners_refuses_the_design(monkeypatch: pytest.MonkeyPatch) -> None:
    """Such a drive has not been met; here the proof is given gains far too high."""
    made = design(SURFACE, TOLERANCES)
    box, gains = solved(made)
    assert gains.speed is not None
    wild = replace(gains.speed, kp=60.0 * gains.speed.kp, ki=60.0 * gains.speed.ki)
    proof = prove_speed_loop(box, wild, gains.i_q)
    assert proof.unstable is not None
    assert set(proof.unstable) == {"r_s", "l_q", "v_dc", "torque over inertia"}
    monkeypatch.setattr("dqforge.optimizer.speed_box.prove_speed_loop", lambda *_, **__: proof)
    with pytest.raises(NoSolutionError, match=r"speed loop is unstable at r_s [+-].*narrow"):
        solve_gains(made)
