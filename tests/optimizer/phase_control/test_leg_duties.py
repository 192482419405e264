"""Legs of every topology: what their duty cycles make of a link, and the least link that does."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from dqforge.machines.arrays import FloatArray
from dqforge.machines.modulation.modulators import modulate
from dqforge.machines.names import ModulationName, Topology
from dqforge.optimizer.phase_control.leg_duties import legs_of
from dqforge.optimizer.phase_control.phase_records import Alphabetazero
from dqforge.optimizer.steps.step_arithmetic import EXACT, AlphaBeta

COUNT = 400
RNG = np.random.default_rng(4)
ALPHA, BETA, ZERO = RNG.uniform(-60.0, 60.0, (3, COUNT))
ROOT = np.sqrt(0.75)
PLANE = np.array([ALPHA, -0.5 * ALPHA + ROOT * BETA, -0.5 * ALPHA - ROOT * BETA])
WHOLE = PLANE + ZERO


def made(topology: Topology, legs: Any, v_dc: float, v_m: float) -> FloatArray:
    """Voltages over the phases that the mean potentials of the legs make, shape (3, N)."""
    volts = np.array([np.broadcast_to(leg, COUNT) for leg in legs]) * v_dc
    if topology == "four-leg":
        return np.asarray(volts[:3] - volts[3])
    if topology == "split-capacitor":
        return np.asarray(volts - v_m)
    return np.asarray(volts[:3] - volts[3:])


@pytest.mark.parametrize("topology", ["four-leg", "six-leg", "six-leg-isolated", "split-capacitor"])
def test_duties_make_the_voltage_and_the_needed_link_is_the_least(topology: Topology) -> None:
    legs: Any = legs_of(topology, "svpwm")
    voltage = Alphabetazero(ALPHA, BETA, ZERO)
    v_dc, v_m = 500.0, 230.0
    more = (v_m,) if topology == "split-capacitor" else ()
    full = tuple(np.full(COUNT, value) for value in (v_dc, *more))
    duties = legs.duties(EXACT, voltage, *full)
    # Two links that share nothing carry no zero sequence.
    wanted = PLANE if topology == "six-leg-isolated" else WHOLE
    found = made(topology, duties, v_dc, v_m)
    if topology == "six-leg-isolated":
        found = found - np.mean(found, axis=0)
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    assert np.min(duties) >= 0.0
    assert np.max(duties) <= 1.0
    none = legs.duties(EXACT, voltage, *(np.full(COUNT, -1.0) for _ in full))
    np.testing.assert_array_equal(np.array(list(none)), 0.5)
    if topology == "split-capacitor":
        return
    needed = legs.needed_voltage(EXACT, voltage)
    phase = {
        "four-leg": np.maximum(WHOLE.max(axis=0), 0.0) - np.minimum(WHOLE.min(axis=0), 0.0),
        "six-leg": np.abs(WHOLE).max(axis=0),
        "six-leg-isolated": 0.5 * np.ptp(WHOLE, axis=0),
    }[topology]
    np.testing.assert_allclose(needed, phase, rtol=1e-12)
    if topology != "six-leg-isolated":
        at = legs.duties(EXACT, voltage, needed)
        np.testing.assert_allclose(made(topology, at, 1.0, 0.0) * needed, WHOLE, atol=1e-9)


@pytest.mark.parametrize("modulation", ["spwm", "thipwm6", "thipwm4", "svpwm", "dpwm1", "dpwmmin"])
def test_three_legs_need_what_their_modulator_takes(modulation: ModulationName) -> None:
    """The least link at which the duty cycles of the modulator lie within 0 and 1."""
    legs: Any = legs_of("three-wire", modulation)
    needed = np.asarray(legs.needed_voltage(EXACT, AlphaBeta(ALPHA, BETA)))
    for share, within in ((1.0 + 1e-9, True), (0.999, False)):
        for n in range(0, COUNT, 10):
            volts = PLANE[:, n]
            duty = modulate(modulation, volts, 0.7 * volts, share * float(needed[n])).duty
            inside = np.min(duty) >= -1e-8 and np.max(duty) <= 1.0 + 1e-8
            assert inside == within


@pytest.mark.parametrize("topology", ["three-wire", "four-leg", "six-leg", "split-capacitor"])
def test_the_share_of_a_voltage_fits_the_link(topology: Topology) -> None:
    legs: Any = legs_of(topology, "svpwm")
    voltage, part = Alphabetazero(ALPHA, BETA, ZERO), 0.9
    for v_dc in (40.0, 110.0, 900.0):
        if topology == "split-capacitor":
            v_m = 0.4 * v_dc
            share = legs.voltage_share(
                EXACT, voltage, part, *(np.full(COUNT, x) for x in (v_dc, v_m))
            )
            room = np.minimum(
                part * (v_dc - v_m) / np.maximum(WHOLE.max(axis=0), 1e-9),
                part * v_m / np.maximum(-WHOLE.min(axis=0), 1e-9),
            )
        else:
            share = legs.voltage_share(EXACT, voltage, part, np.full(COUNT, v_dc))
            asked = AlphaBeta(ALPHA, BETA) if topology == "three-wire" else voltage
            room = part * v_dc / legs.needed_voltage(EXACT, asked)
        np.testing.assert_allclose(share, np.minimum(room, 1.0), rtol=1e-9)
    more = (np.full(COUNT, 5.0),) if topology == "split-capacitor" else ()
    wrong = legs.voltage_share(EXACT, voltage, part, np.full(COUNT, -1.0), *more)
    np.testing.assert_array_equal(wrong, -1.0)
