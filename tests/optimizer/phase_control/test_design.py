"""Control of phase machines: what each topology and frame gets, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.catalogue import load_text
from dqforge.machines.design.design import Design
from dqforge.machines.errors import DqforgeError, NoSolutionError
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import SalientPhaseMachine
from dqforge.optimizer.control_design.gain_set import solve_gains
from dqforge.optimizer.phase_control.design import PhaseLoops, harmonic_orders, midpoint_gains
from dqforge.optimizer.phase_control.phase_controller import limit_at
from dqforge.optimizer.waveforms.constraint_rows import pointwise_currents

P = "paper002-phase-waveforms"


def design(*settings: str, drive: str = P) -> Design:
    return load_text(catalogue.read_text(drive), f"{drive}.yaml", None, list(settings))


def loops(*settings: str, drive: str = P) -> PhaseLoops:
    found = solve_gains(design(*settings, drive=drive)).phases
    assert found is not None
    return found


@pytest.mark.thinned
@pytest.mark.parametrize(
    ("topology", "neutral"),
    [
        ("three-wire", False),
        ("four-leg", True),
        ("six-leg", True),
        ("six-leg-isolated", False),
        ("split-capacitor", True),
        ("diode-neutral", False),
    ],
)
def test_every_topology_gets_the_table(topology: Topology, neutral: bool) -> None:
    found = loops(f"inverter.topology={topology}").control
    assert (found.frame, found.topology) == ("table", topology)
    assert found.inductances == pytest.approx((8e-3, 8e-3, 5e-3), rel=1e-9)
    omega, r_s = 2.0 * np.pi * 300.0, 1.0
    for gains, inductance in zip(found.gains[:2], found.inductances[:2], strict=True):
        assert (gains.kp, gains.ki) == pytest.approx((omega * inductance, omega * r_s), rel=1e-9)
    zero = (omega * 5e-3, omega * r_s) if neutral else (0.0, 0.0)
    assert (found.gains[2].kp, found.gains[2].ki) == pytest.approx(zero, rel=1e-9)
    assert found.harmonics is not None
    assert found.harmonics.plane == (-5, 7, -11, 13)
    assert found.harmonics.zero == ((3, 9) if neutral else ())
    assert found.harmonics.frequency_max == pytest.approx(10e3 / 6.0)
    assert found.harmonics.error_max == pytest.approx(1.0, abs=0.02)


def test_the_largest_torque_is_that_of_the_phase_with_the_largest_current() -> None:
    # F of P from its printed harmonics, on angles of the test's own.
    theta = 2.0 * np.pi * np.arange(100_000) / 100_000
    flux = np.zeros((3, theta.size))
    for order, share in ((1, 1.0), (3, 0.12), (5, 0.03), (7, 0.01)):
        for k in range(3):
            flux[k] -= 0.2233 * share * np.sin(order * (theta - 2.0 * np.pi * k / 3.0))
    i_max = 4.2 * np.sqrt(2.0)
    unit = flux / (2.0 * np.sum(flux**2, axis=0))
    # The table lies 0.1 % off at most.
    assert loops().control.torque_max == pytest.approx(i_max / np.max(np.abs(unit)), rel=1e-3)
    flux = flux - np.mean(flux, axis=0)
    unit = flux / (2.0 * np.sum(flux**2, axis=0))
    found = loops("inverter.topology=three-wire").control
    assert found.torque_max == pytest.approx(i_max / np.max(np.abs(unit)), rel=1e-3)


def test_a_choke_in_the_neutral_counts_three_times() -> None:
    found = loops("inverter.neutral_inductance=1 mH").control
    assert found.inductances[2] == pytest.approx(8e-3, rel=1e-9)


def test_a_sine_gets_dq() -> None:
    found = loops("machine.back_emf.harmonics=[{order: 1, amplitude: 0.2 Wb}]").control
    assert found.frame == "dq"


@pytest.mark.thinned
@pytest.mark.parametrize("frame", ["dq", "table"])
def test_saliency_keeps_both_inductances(frame: str) -> None:
    salient = "salient-phase-waveforms"
    found = loops(f"control.current_loop.frame={frame}", drive=salient).control
    assert found.frame == frame
    assert found.inductances == pytest.approx((5.3e-3, 10.7e-3, 5e-3), rel=1e-6)
    # 120 V: both are limited near the largest speed, and neither at half of it.
    limit = found.torque_limit
    assert limit is not None
    at = limit_at(limit, 377.0 * np.array([0.4, 0.95]), np.full(2, 120.0))
    assert at[0] == pytest.approx(found.torque_max)
    assert at[1] < 0.7 * found.torque_max


@pytest.mark.slow
def test_the_table_of_a_salient_machine_goes_to_the_current_limit_at_least_loss() -> None:
    """Currents of least loss make reluctance torque, those along the back-EMF next to none."""
    made = design(drive="salient-phase-waveforms")
    machine, i_max = made.phase_machine, made.i_max
    assert isinstance(machine, SalientPhaseMachine)
    along = machine.flux / (2.0 * np.sum(machine.flux**2, axis=0))
    found = loops("control.current_loop.frame=table", drive="salient-phase-waveforms").control
    currents = pointwise_currents(machine, np.array([found.torque_max]), "four-leg")
    assert np.max(np.abs(currents)) == pytest.approx(i_max, rel=1e-3)
    torque = machine.torque(currents)
    assert np.mean(torque) == pytest.approx(found.torque_max, rel=1e-9)
    assert np.ptp(torque) < 1e-6 * found.torque_max
    copper = [machine.copper_loss(x) for x in (currents[0], found.torque_max * along)]
    assert copper[0] < 0.99 * copper[1]


@pytest.mark.slow
def test_one_gain_is_refused_from_the_ratio_of_the_page_on() -> None:
    fast = ("control.current_loop.bandwidth=500 Hz", "control.current_loop.min_phase_margin=1 deg")
    one = (*fast, "control.current_loop.axis_gains=one")
    limit = 10e3 / (2.0 * np.pi * 500.0)
    for ratio in (1.001, 1.5):
        with pytest.raises(DqforgeError, match=r"permits 3.18; write own"):
            loops(*one, mutual(ratio * limit))
        assert loops(*fast, mutual(ratio * limit)).control.gains[2].kp > 0.0
    # Just below, the loop that is judged on its sampled plant is stable, but has little margin.
    for share, margin in ((0.94, True), (0.5, True), (0.999, False)):
        if margin:
            found = loops(*one, mutual(share * limit)).control
            assert found.gains[2] == found.gains[1]
        else:
            with pytest.raises(DqforgeError, match="the zero sequence a phase margin"):
                loops(*one, mutual(share * limit))


def mutual(ratio: float) -> str:
    """M_s of 7 mH of self inductance with L_ab/L_0 = (7 + m)/(7 - 2 m)."""
    return f"machine.mutual_inductance={-7.0 * (ratio - 1.0) / (1.0 + 2.0 * ratio):.9f} mH"


def test_given_gains_scale_with_the_inductance() -> None:
    text = catalogue.read_text(P).replace(
        b"    method: bandwidth\n    bandwidth: 300 Hz\n",
        b"    method: given\n    kp: 16 V/A\n    ki: 800 V/(A s)\n",
    )
    found = solve_gains(load_text(text, "given.yaml")).phases
    assert found is not None
    zero = found.control.gains[2]
    assert (zero.kp, zero.ki) == pytest.approx((10.0, 500.0))


@pytest.mark.slow
def test_pole_pairs_that_differ_get_a_table_over_the_mechanical_turn() -> None:
    """The first order of the mechanical turn: the second pole pair is weaker than the first."""
    found = loops(
        "inverter.topology=six-leg",
        "machine.back_emf.harmonics=[{order: 1, amplitude: 0.2 Wb}, "
        "{mechanical_order: 1, share: 2 %}]",
    )
    assert found.control.frame == "table"
    assert found.control.shape.turns == 2
    assert found.control.shape.flux.shape[0] == 3
    assert found.shape.error <= 1e-3
    assert found.control.torque_limit is not None


def test_orders_follow_what_disturbs() -> None:
    """Equal phases with even harmonics, and phases that differ, in words of the symmetry."""
    theta = 2.0 * np.pi * np.arange(2880) / 2880
    lag = theta - 2.0 * np.pi / 3.0 * np.arange(3)[:, np.newaxis]
    plane, zero = harmonic_orders(-np.sin(lag), -np.sin(lag), 1)
    assert (plane, zero) == ((-5, 7, -11, 13), (3, 9))
    even = -np.sin(lag) - 0.2 * np.sin(2.0 * lag)
    plane, zero = harmonic_orders(even, even, 1)
    assert -2 in plane
    assert all((order - 1) % 3 == 0 for order in plane)
    assert all(order % 3 == 0 for order in zero)
    weak = -np.sin(lag) * np.array([[1.0], [0.0], [1.0]])
    plane, zero = harmonic_orders(weak, weak, 1)
    assert {-1, 3, -3} <= set(plane)
    assert 1 in zero
    assert len(plane) <= 8
    assert len(zero) <= 4


def test_the_balance_of_a_split_link() -> None:
    """omega_e_min = 2 I_n3/(3 C dv) for a neutral current of order 3 alone; bandwidth 3 k/C."""
    theta = 2.0 * np.pi * np.arange(2880) / 2880
    unit, torque, capacitance, v_dc = 0.3 * np.sin(3.0 * theta), 4.0, 4e-3, 220.0
    found = midpoint_gains(unit, 1, torque, capacitance, v_dc)
    peak = 3.0 * 0.3 * torque
    expected = 2.0 * peak / (3.0 * capacitance * 0.05 * v_dc)
    assert found.omega_e_min == pytest.approx(expected, rel=1e-4)
    assert 9.0 < 3.0 * found.balance / capacitance < 43.0
    with pytest.raises(NoSolutionError, match="does not carry; write dqx"):
        midpoint_gains(unit + 0.1, 1, torque, capacitance, v_dc)


def test_one_set_of_gains_that_leaves_no_margin_names_its_own_key() -> None:
    """At 800 Hz L_ab/L_0 of 1.6 is stable, with 19 degrees left in the zero sequence."""
    one = ("control.current_loop.bandwidth=800 Hz", "control.current_loop.axis_gains=one")
    with pytest.raises(NoSolutionError, match=r"axis_gains: one set .* margin of 18\.9 deg.*own"):
        loops(*one)
