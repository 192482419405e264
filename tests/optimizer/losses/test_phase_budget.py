"""Losses of every leg of every topology: against an integration of the switched waveforms, against
the budget of three legs, and the figures that decide for or against a fourth leg.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from phase_shapes import FUNDAMENTAL_P, paper_machine, trapezoid_machine

from dqforge.machines.arrays import BoolArray, FloatArray
from dqforge.machines.design import catalogue
from dqforge.machines.devices.inverter import Inverter, SwitchDevice
from dqforge.machines.dq_machines.synchronous import LinearMachine
from dqforge.machines.losses.machine_budget import MachineLoss, WindingHeat
from dqforge.machines.modulation.modulators import MODULATORS
from dqforge.machines.names import ModulationName, Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, SalientPhaseMachine
from dqforge.optimizer.losses.drive_budget import PARTS, BudgetOptions, drive_budget
from dqforge.optimizer.losses.phase_comparison import PhaseBudget, phase_budget
from dqforge.optimizer.waveforms.constraint_rows import CurrentRule, dq_waveform, unit_currents

OMEGA_M = 750.0 * np.pi / 30.0
RATED = 3.98
IGBT = catalogue.load("paper002-pmsm-nonsinusoidal").inverter

# Of 40 mOhm; conduction alone.
MOSFET = replace(
    IGBT,
    device=SwitchDevice("mosfet", 40e-3, 0.0, 0.0, 20.0, 300.0, 2.0),
)


def _budget(
    machine: PhaseMachine,
    inverter: Inverter,
    topology: Topology,
    rule: CurrentRule,
    torque: float,
    options: BudgetOptions | None = None,
) -> PhaseBudget:
    currents = torque * unit_currents(machine, rule)[np.newaxis]
    fed = replace(inverter, topology=topology)
    return phase_budget(machine, fed, currents, np.array([OMEGA_M]), options=options)


def _rule(topology: Topology) -> CurrentRule:
    return "dqy" if topology in ZERO_SEQUENCE else "dqx"


def _total(found: PhaseBudget) -> float:
    return float(found.budget.total[0, 0])


# The switched waveforms of one electrical period, integrated in time: legs, currents with their
# ripple, the device that carries each of them. Nothing of the package but the device's constants.

CARRIERS, PLACES = 400, 400

LEGS: dict[Topology, list[list[float]]] = {
    "three-wire": np.eye(3).tolist(),
    "split-capacitor": np.eye(3).tolist(),
    "four-leg": np.hstack([np.eye(3), -np.ones((3, 1))]).tolist(),
    "six-leg": np.hstack([np.eye(3), -np.eye(3)]).tolist(),
    "six-leg-isolated": np.hstack([np.eye(3), -np.eye(3)]).tolist(),
}

ZERO_SEQUENCE = {"four-leg", "split-capacitor", "six-leg"}


@dataclass(frozen=True)
class Switched:
    """Losses in W by legs, r.m.s. of the neutral ripple in A, copper of the ripple in W, mean
    current from the link in A, mean square in A^2 of what its capacitors carry without ripple.
    """

    conduction: FloatArray
    switching: FloatArray
    neutral_ripple: float
    ripple_copper: float
    link_current: float
    capacitor_square: float


def _flux(theta: FloatArray) -> FloatArray:
    """Back-EMF over electrical speed of the paper's machine, shape (3, ...)."""
    shares = ((1, 1.0), (3, 0.12), (5, 0.03), (7, 0.01))
    turned = [theta - 2.0 * np.pi * k / 3.0 for k in range(3)]
    return np.stack(
        [-FUNDAMENTAL_P * sum(share * np.sin(h * t) for h, share in shares) for t in turned]
    )


def _wanted(theta: FloatArray, torque: float, *, neutral: bool) -> FloatArray:
    """Currents of constant torque with and without zero sequence, shape (3, ...)."""
    shape = _flux(theta)
    if not neutral:
        shape = shape - np.mean(shape, axis=0)
    return np.asarray(torque * shape / (2.0 * np.sum(shape**2, axis=0)))


def _own_duties(topology: Topology, v: FloatArray, v_dc: float) -> FloatArray:
    """Duty cycles (legs, N) of phase voltages (3, N)."""
    if topology == "split-capacitor":
        return 0.5 + v / v_dc
    ends = np.vstack([v, np.zeros_like(v[:1])]) if topology == "four-leg" else v
    if topology != "six-leg":
        ends = ends - 0.5 * (np.max(ends, axis=0) + np.min(ends, axis=0))
    if topology.startswith("six"):
        return np.vstack([0.5 + 0.5 * ends / v_dc, 0.5 - 0.5 * ends / v_dc])
    return 0.5 + ends / v_dc


def switched_losses(topology: Topology, torque: float, inverter: Inverter) -> Switched:
    """The switched drive, a point of the period after the other."""
    device, v_dc, t_s = inverter.device, inverter.v_dc, 1.0 / inverter.f_sw
    assert device is not None
    neutral = topology in ZERO_SEQUENCE
    matrix = np.array(LEGS[topology])
    l_matrix = -1e-3 + 8e-3 * np.eye(3)
    omega = 2.0 * OMEGA_M
    theta = 2.0 * np.pi * (np.arange(CARRIERS) + 0.5) / CARRIERS
    step = 1e-5
    slope = (
        _wanted(theta + step, torque, neutral=neutral)
        - _wanted(theta - step, torque, neutral=neutral)
    ) / (2.0 * step)
    voltage = 1.0 * _wanted(theta, torque, neutral=neutral) + omega * (
        l_matrix @ slope + _flux(theta)
    )
    if not neutral:
        voltage = voltage - np.mean(voltage, axis=0)
    duty = _own_duties(topology, voltage, v_dc)
    inverse = np.linalg.inv(l_matrix)
    if not neutral:
        inverse = (np.eye(3) - 1.0 / 3.0) / 8e-3

    def phases(places: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Currents and their ripple (3, N, S) at places (N, S) of each carrier, -1/2 to 1/2."""
        on = np.clip(places + 0.5 * duty[:, :, None], 0.0, duty[:, :, None])
        flux = v_dc * t_s * (on - duty[:, :, None] * (places + 0.5))
        ripple = np.einsum("kj,jl,lns->kns", inverse, matrix, flux)
        angle = theta[:, None] + omega * t_s * places
        return _wanted(angle, torque, neutral=neutral), ripple

    middle = np.broadcast_to((np.arange(PLACES) + 0.5) / PLACES - 0.5, (CARRIERS, PLACES))
    slow, ripple = phases(middle)
    current = np.einsum("kl,kns->lns", matrix, slow + ripple)
    high = np.abs(middle) < 0.5 * duty[:, :, None]
    forward = high == (current > 0.0)
    size = np.abs(current)
    transistor = device.on_voltage * size + device.on_resistance * size**2
    diode = device.diode_voltage * size + device.diode_resistance * size**2
    if device.kind == "mosfet":
        diode = transistor
    conduction = np.mean(np.where(forward, transistor, diode), axis=(1, 2))
    per_volt_ampere = v_dc / (device.reference_current * device.reference_voltage)
    on_energy = device.turn_on_energy + device.reverse_recovery_energy
    switching = np.zeros(matrix.shape[1])
    for leg in range(matrix.shape[1]):
        for sign in (-1.0, 1.0):
            at, around = phases(0.5 * sign * duty[leg][:, None])
            edge = np.einsum("k,kns->ns", matrix[:, leg], at + around)[:, 0]
            # The leg rises at the first edge: a current out of it is taken over from a diode.
            taken = (edge > 0.0) == (sign < 0.0)
            energy = np.where(taken, on_energy, device.turn_off_energy)
            switching[leg] += (
                inverter.f_sw * per_volt_ampere * float(np.mean(energy * np.abs(edge)))
            )
    return Switched(
        conduction,
        switching,
        float(np.sqrt(np.mean(np.sum(ripple, axis=0) ** 2))),
        float(np.mean(np.sum(ripple**2, axis=0))),
        float(np.mean(np.sum(high * current, axis=0))),
        _capacitor_square(topology, high, np.einsum("kl,kns->lns", matrix, slow)),
    )


def _capacitor_square(topology: Topology, high: BoolArray, current: FloatArray) -> float:
    """Of two isolated links both together; of two halves in series half of each."""
    if topology == "six-leg-isolated":
        links = [np.sum((high * current)[part], axis=0) for part in (slice(0, 3), slice(3, 6))]
        return float(sum(np.var(link) for link in links))
    upper = np.sum(high * current, axis=0)
    if topology != "split-capacitor":
        return float(np.var(upper))
    lower = upper - np.sum(current, axis=0)  # what the lower rail takes back, with its sign
    halves = [side - np.mean(side) for side in (upper, lower)]
    return float(0.5 * sum(np.mean(side**2) for side in halves))


@pytest.mark.parametrize("device", [IGBT, MOSFET], ids=["igbt", "mosfet"])
@pytest.mark.parametrize("topology", list(LEGS))
def test_every_leg_loses_what_the_switched_waveforms_lose(
    topology: Topology, device: Inverter
) -> None:
    """Conduction of all legs within 0.5 % and of each within 1 % of the largest, switching within
    1 %, the pulses' own neutral current and copper within 1 %, power of the link within 0.5 %,
    what its capacitors carry within 1 %.
    """
    torque, rule = 3.0, _rule(topology)
    inverter = replace(device, dead_time=0.0, topology=topology)
    found = _budget(paper_machine(), inverter, topology, rule, torque)
    exact = switched_losses(topology, torque, inverter)
    budget = found.budget
    assert budget.conduction[0, 0] == pytest.approx(np.sum(exact.conduction), rel=5e-3)
    assert budget.switching[0, 0] == pytest.approx(np.sum(exact.switching), rel=1e-2)
    legs = exact.conduction + exact.switching
    assert found.leg_loss[0, 0] == pytest.approx(legs, abs=1e-2 * np.max(legs))
    assert budget.ripple_copper[0, 0] == pytest.approx(exact.ripple_copper, rel=1e-2)
    assert found.neutral_ripple[0, 0] == pytest.approx(exact.neutral_ripple, rel=1e-2, abs=1e-9)
    out = budget.shaft_power[0, 0] + budget.copper[0, 0]
    assert budget.capacitor_current[0, 0] ** 2 == pytest.approx(exact.capacitor_square, rel=1e-2)
    # The sum over 400 places of a carrier knows its edges to an eight-hundredth.
    assert inverter.v_dc * exact.link_current == pytest.approx(out, rel=5e-3)


@pytest.mark.parametrize("name", ["spwm", "svpwm", "dpwm1", "dpwmmin", "ddt-gdpwm"])
def test_sinusoids_on_three_legs_cost_what_the_budget_of_dq_machines_says(
    name: ModulationName,
) -> None:
    """With every loss of machine, bridge and winding; phases that rest have corners, which 360
    angles meet to 3e-3.
    """
    linear = LinearMachine(pole_pairs=2, r_s=1.0, l_d=8e-3, l_q=8e-3, psi_pm=0.2233, i_max=6.0)
    sinus = PhaseMachine.from_harmonics(
        [1], [0.2233], [0.0], pole_pairs=2, r_s=1.0, l_s=7e-3, m_s=-1e-3, i_max=6.0
    )
    losses = MachineLoss(ac_copper=1e-6, hysteresis=0.4, eddy=1e-3, magnet=1e-6)
    options = BudgetOptions(losses, WindingHeat(1.5), capacitor_esr=0.05, sheet_corner=2e3)
    i_d, i_q, omega = np.array([-1.0, 0.5]), np.array([4.0, -3.0]), np.array([60.0, 120.0])
    waves = np.stack([dq_waveform(d, q, 360) for d, q in zip(i_d, i_q, strict=True)])
    quiet = replace(options, ripple_resistance=None)
    exact = drive_budget(linear, IGBT, i_d, i_q, omega, [name], options=quiet)
    found = phase_budget(sinus, IGBT, waves, omega, modulation=name, options=quiet).budget
    for part in (*PARTS, "total", "input_power", "junction_temperature", "voltage_error"):
        close = 3e-3 if MODULATORS[name].rests else 1e-3
        assert getattr(found, part) == pytest.approx(getattr(exact, part)[0], rel=close, abs=1e-12)
    assert np.max(np.abs(found.imbalance)) < 1e-10
    # What the switching adds to the copper and to the iron, too.
    exact = drive_budget(linear, IGBT, i_d, i_q, omega, [name], options=options)
    found = phase_budget(sinus, IGBT, waves, omega, modulation=name, options=options).budget
    for part in ("ripple_copper", "ripple_iron", "ripple_current"):
        assert getattr(found, part) == pytest.approx(getattr(exact, part)[0], rel=3e-3)


@pytest.mark.parametrize(
    ("machine", "saved", "leg", "lost", "gained", "six"),
    [
        (paper_machine(), 0.72, 2.07, 1.76, 0.66, (39.3, 19.3)),
        (trapezoid_machine(), 1.80, 3.24, 1.71, 1.68, (35.6, 17.5)),
    ],
    ids=["P", "Z"],
)
def test_a_fourth_leg_costs_more_than_it_saves_with_igbts(
    machine: PhaseMachine,
    saved: float,
    leg: float,
    lost: float,
    gained: float,
    six: tuple[float, float],
) -> None:
    """At rated torque: copper saved by dqy, loss of the neutral leg, net loss with IGBTs, net gain
    with MOSFETs of 40 mOhm, and the bridge of six legs beside that of three.
    """
    quiet = BudgetOptions(ripple_resistance=None)
    star = _budget(machine, IGBT, "three-wire", "dqx", RATED, quiet)
    four = _budget(machine, IGBT, "four-leg", "dqy", RATED, quiet)
    copper = star.budget.copper - four.budget.copper
    assert copper[0, 0] == pytest.approx(saved, abs=0.01)
    assert four.leg_loss[0, 0, 3] == pytest.approx(leg, abs=0.01)
    assert _total(four) - _total(star) == pytest.approx(lost, abs=0.02)
    # At its edges the neutral leg switches less than its mean current: 2 % of its loss.
    switched = _budget(machine, IGBT, "four-leg", "dqy", RATED)
    assert 0.97 * leg < switched.leg_loss[0, 0, 3] < leg
    star_and_four: tuple[tuple[Topology, CurrentRule], ...] = (
        ("three-wire", "dqx"),
        ("four-leg", "dqy"),
    )
    with_mosfets = [
        _total(_budget(machine, MOSFET, topology, rule, RATED, quiet))
        for topology, rule in star_and_four
    ]
    assert with_mosfets[0] - with_mosfets[1] == pytest.approx(gained, abs=0.015)
    six_and_three: tuple[tuple[Topology, CurrentRule], ...] = (
        ("six-leg", "dqy"),
        ("three-wire", "dqx"),
    )
    bridges = [
        float(np.sum(_budget(machine, IGBT, topology, rule, RATED).leg_loss))
        for topology, rule in six_and_three
    ]
    assert bridges == pytest.approx(list(six), abs=0.1)


@pytest.mark.parametrize(
    ("torque", "copper"),
    [(1.0, (3.346, 3.305, 3.303, 3.561)), (0.3, (3.38, 3.39, 3.36, 6.25))],
)
def test_on_a_split_link_the_switching_costs_more_copper_than_dqy_saves(
    torque: float, copper: tuple[float, ...]
) -> None:
    """Copper with what the pulses add, over the square of the torque, at 750 rpm."""
    rows: tuple[tuple[Topology, CurrentRule], ...] = (
        ("three-wire", "dqx"),
        ("four-leg", "dqy"),
        ("six-leg", "dqy"),
        ("split-capacitor", "dqy"),
    )
    for (topology, rule), expected in zip(rows, copper, strict=True):
        budget = _budget(paper_machine(), IGBT, topology, rule, torque).budget
        found = (budget.copper[0, 0] + budget.ripple_copper[0, 0]) / torque**2
        assert found == pytest.approx(expected, rel=4e-3)


@given(
    st.sampled_from([*LEGS, "diode-neutral"]),
    st.floats(-4.0, 4.0),
    st.floats(0.0, 180.0),
    st.floats(0.0, 0.3),
)
def test_power_in_is_power_out_with_every_topology(
    topology: Topology, torque: float, omega: float, neutral_ohms: float
) -> None:
    """The link gives what shaft and losses take, to rounding, also with iron loss."""
    machine = trapezoid_machine(72)
    inverter = replace(IGBT, topology=topology, neutral_resistance=neutral_ohms)
    rule = _rule(topology)
    currents = torque * unit_currents(machine, rule)[np.newaxis]
    options = BudgetOptions(MachineLoss(1e-6, 0.4, 1e-3, 1e-6), WindingHeat(1.0), 0.1)
    v_dc = replace(inverter, v_dc=400.0)
    found = phase_budget(machine, v_dc, currents, np.array([omega]), options=options).budget
    assert abs(found.imbalance[0, 0]) < 1e-9 * max(1.0, abs(found.input_power[0, 0]))


def test_a_salient_machine_balances_within_its_angles() -> None:
    """Inductances that vary: 1e-4 of the power on 360 angles, and 16 times less on 720."""
    away = []
    for angles in (360, 720):
        phases = paper_machine(angles)
        machine = SalientPhaseMachine.with_second_harmonic(phases, 1.5e-3)
        currents = dq_waveform(-2.0, 4.0, angles)[np.newaxis]
        budget = phase_budget(machine, IGBT, currents, np.array([OMEGA_M])).budget
        away.append(abs(float(budget.imbalance[0, 0] / budget.input_power[0, 0])))
    assert away[0] < 1e-4
    assert away[1] < max(away[0] / 16.0, 1e-12)


def test_the_neutral_conductor_counts_once_it_is_given() -> None:
    """Its resistance times the square of the sum of the currents, of the switching too."""
    plain = _budget(paper_machine(), IGBT, "four-leg", "dqy", 2.0)
    given_ = _budget(paper_machine(), replace(IGBT, neutral_resistance=0.2), "four-leg", "dqy", 2.0)
    square = plain.neutral_current[0, 0] ** 2
    assert given_.budget.copper[0, 0] - plain.budget.copper[0, 0] == pytest.approx(0.2 * square)
    more = given_.budget.ripple_copper[0, 0] - plain.budget.ripple_copper[0, 0]
    assert more == pytest.approx(0.2 * plain.neutral_ripple[0, 0] ** 2, rel=3e-2)


def test_a_choke_in_the_neutral_quiets_the_switching() -> None:
    """3 L_n beside L_0: the neutral ripple falls as L_0 / (L_0 + 3 L_n)."""
    bare = _budget(paper_machine(), IGBT, "four-leg", "dqx", 2.0)
    choked = _budget(
        paper_machine(), replace(IGBT, neutral_inductance=5e-3 / 3.0), "four-leg", "dqx", 2.0
    )
    assert choked.neutral_ripple[0, 0] == pytest.approx(0.5 * bare.neutral_ripple[0, 0], rel=1e-9)


def test_without_a_device_the_legs_are_unknown() -> None:
    """No watts of a bridge that nobody knows."""
    found = _budget(paper_machine(), replace(IGBT, device=None), "four-leg", "dqy", 2.0)
    assert np.all(np.isnan(found.leg_loss))
    assert np.isfinite(found.budget.total[0, 0])
    assert np.isnan(found.budget.junction_temperature[0, 0])


def test_dead_time_takes_twice_the_volts_of_two_legs() -> None:
    """Six legs lose at both ends of each phase; its volts fall on the neutral of four as well."""
    volts = {
        topology: _budget(paper_machine(), IGBT, topology, "dqx", 2.0).budget.voltage_error[0, 0]
        for topology in ("three-wire", "six-leg")
    }
    assert volts["six-leg"] == pytest.approx(2.0 * volts["three-wire"], rel=1e-9)
    # 4/pi t_d f_sw V_dc for sinusoids.
    assert volts["three-wire"] == pytest.approx(4.0 / np.pi * 2.2, rel=2e-2)


@pytest.mark.parametrize("topology", ["three-wire", "four-leg"])
def test_equal_pole_pairs_over_a_mechanical_turn_lose_what_one_period_says(
    topology: Topology,
) -> None:
    """The same back-EMF written over two electrical periods: every figure as before."""
    once = paper_machine(120)
    twice = replace(once, flux=np.tile(once.flux, (1, 2)), turns=2)
    one, two = (_budget(machine, IGBT, topology, "dqx", 2.0) for machine in (once, twice))
    for part in (*PARTS, "total", "voltage", "input_power", "torque"):
        found = getattr(two.budget, part)
        assert found == pytest.approx(getattr(one.budget, part), rel=1e-9, abs=1e-12)
    assert two.link_demand == pytest.approx(one.link_demand, rel=1e-9)


@pytest.mark.parametrize("v_dc", [400.0, 150.0])
def test_marks_and_largest_values_are_those_of_the_legs(v_dc: float) -> None:
    """Three points, one of them hot: what is cool, linear and how hot, from the legs' own rows."""
    machine = trapezoid_machine(72)
    currents = np.array([0.2, 1.0, 3.0])[:, None, None] * unit_currents(machine, "dqx")
    omega = np.array([30.0, 60.0, 120.0])
    assert IGBT.device is not None
    options = BudgetOptions(MachineLoss(1e-6, 0.4, 1e-3, 1e-6), WindingHeat(1.0), 0.1)
    inverter = replace(IGBT, topology="four-leg", v_dc=v_dc)
    found = phase_budget(machine, inverter, currents, omega, options=options)
    hottest = found.leg_temperature.max(axis=-1)
    budget = found.budget
    np.testing.assert_allclose(
        np.maximum(budget.junction_temperature, budget.diode_temperature), hottest
    )
    parts = sum(getattr(budget, part) for part in PARTS)
    np.testing.assert_allclose(budget.total, parts)
    left = 1.0 - 2.0 * inverter.dead_time * inverter.f_sw
    room = found.link_demand <= v_dc
    assert (budget.linear <= room).all()
    assert (budget.linear >= (found.link_demand <= v_dc * left)).all()
    between = float(0.5 * (hottest[0, 1] + hottest[0, 2]))
    device = replace(IGBT.device, max_junction_temperature=between)
    cooler = phase_budget(
        machine, replace(inverter, device=device), currents, omega, options=options
    )
    np.testing.assert_array_equal(cooler.budget.cool_enough, [[True, True, False]])
    # A channel whose diode drops more: the dead time costs what it carries the longer.
    diode = replace(IGBT.device, kind="mosfet", on_voltage=0.0, diode_voltage=1.5)
    legs = phase_budget(machine, replace(inverter, device=diode), currents, omega, options=options)
    part = legs.budget
    assert np.all(part.dead_time > 0.0)
    bridge = part.conduction + part.switching + part.dead_time
    np.testing.assert_allclose(legs.leg_loss.sum(axis=-1), bridge)
    np.testing.assert_array_equal(budget.cool_enough, hottest <= 175.0)
    # Slow enough for no power at all but what is lost.
    shaft = budget.shaft_power[0]
    np.testing.assert_allclose(budget.input_power[0], shaft + budget.total[0], rtol=1e-6)
    np.testing.assert_allclose(budget.torque[0] * omega, shaft, rtol=1e-9)
