"""The largest fundamental of each topology, in everything that asks for the voltage limit."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design, back_emf_warning
from dqforge.machines.devices.inverter import Inverter
from dqforge.machines.errors import InputError
from dqforge.machines.modulation.modulators import linear_limit
from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName, Topology
from dqforge.machines.topologies import amplitude_fits, amplitude_limit, contradiction, linear_share
from dqforge.optimizer.losses.drive_comparison import usable_limit
from dqforge.optimizer.operating_points.characteristics import limited_drive, points_within
from dqforge.optimizer.waveforms.comparison import operating_point

SHARES: dict[Topology, float] = {
    "three-wire": 1.0 / math.sqrt(3.0),
    "diode-neutral": 1.0 / math.sqrt(3.0),
    "four-leg": 1.0 / math.sqrt(3.0),
    "six-leg": 1.0,
    "six-leg-isolated": 2.0 / math.sqrt(3.0),
    "split-capacitor": 0.5,
}


def fed_by(topology: Topology, v_dc: float = 220.0) -> Design:
    design = catalogue.load("paper002-phase-waveforms")
    return replace(design, inverter=replace(design.inverter, topology=topology, v_dc=v_dc))


@pytest.mark.parametrize("topology", get_args(Topology))
@pytest.mark.parametrize("name", ["spwm", "svpwm", "dpwm1"])
def test_share_is_the_topologys_or_the_modulators(topology: Topology, name: ModulationName) -> None:
    inverter = Inverter(v_dc=300.0, f_sw=1e4, topology=topology)
    free = topology in ("three-wire", "diode-neutral")
    share = MODULATORS[name].linear_limit if free else SHARES[topology]
    assert linear_share(topology, name) == pytest.approx(share, rel=1e-15)
    most = amplitude_limit(inverter, name, 0.1)
    assert most == pytest.approx(0.9 * 300.0 * share, rel=1e-14)
    if free:
        assert amplitude_limit(inverter, name, 0.1) == linear_limit(name, 300.0, 0.1)
    edge = 300.0 * share
    amplitudes = np.array([edge * 0.999, edge, edge * 1.001, np.nan])
    assert amplitude_fits(inverter, name, amplitudes).tolist() == [True, True, False, False]


@pytest.mark.parametrize("topology", get_args(Topology))
def test_operating_points_end_where_the_topologys_voltage_ends(topology: Topology) -> None:
    design = fed_by(topology)
    limit = SHARES[topology] * 220.0
    assert design.v_max == pytest.approx(limit, rel=1e-14)
    dead = 1.0 - 2.0 * design.inverter.dead_time * design.inverter.f_sw
    assert usable_limit(design.inverter, "svpwm") == pytest.approx(limit * dead, rel=1e-12)
    drive = limited_drive(design)
    assert drive.limit.v_max == pytest.approx(limit, rel=1e-14)
    assert drive.limit.topology == topology
    # At the speed where the flux of half the current takes the whole voltage, less current flows.
    omega = 1.2 * limit / (design.machine.pole_pairs * design.machine.psi_pm)
    found = points_within(drive, [0.5], [omega]).points
    assert found.voltage[0] == pytest.approx(limit, rel=1e-9)
    assert found.i_d[0] < 0.0
    torque, base = operating_point(design, replace(design.waveform, omega_m=None, torque=2.0))
    i_q = torque / design.machine.torque_per_ampere
    omega_e = np.array([design.machine.pole_pairs * base])
    v_d, v_q = design.machine.voltage(np.zeros(1), np.array([i_q]), omega_e)
    assert np.hypot(v_d, v_q)[0] == pytest.approx(limit, rel=1e-9)


def test_base_speeds_follow_the_voltage() -> None:
    most = {topology: fed_by(topology).v_max for topology in SHARES}
    assert most["split-capacitor"] < most["four-leg"] == most["three-wire"] < most["six-leg"]
    assert most["six-leg-isolated"] == pytest.approx(2.0 * most["three-wire"], rel=1e-14)


@pytest.mark.parametrize("topology", get_args(Topology))
def test_a_modulator_that_the_topology_has_not_is_refused(topology: Topology) -> None:
    free = topology in ("three-wire", "diode-neutral")
    assert contradiction("modulation", topology, "svpwm") == ""
    assert bool(contradiction("modulation", topology, "dpwm1")) != free
    if free:
        assert limited_drive(fed_by(topology), "dpwm1").limit.made_by == "dpwm1"
        return
    assert limited_drive(fed_by(topology)).limit.made_by == topology
    with pytest.raises(InputError, match=f"modulation: {topology} has its own modulator"):
        limited_drive(fed_by(topology), "dpwm1")


def test_back_emf_above_what_the_topology_makes_is_remarked() -> None:
    # 2 pole pairs, 0.3 Wb, 200 rad/s: 120 V of a phase, 208 V between two.
    cases: tuple[tuple[Topology, float, str], ...] = (
        ("three-wire", 200.0, "between two terminals"),
        ("four-leg", 200.0, "between two terminals"),
        ("six-leg", 110.0, "above the 110 V that six-leg makes"),
        ("split-capacitor", 230.0, "above the 115 V that split-capacitor makes"),
    )
    for topology, link, told in cases:
        assert told in back_emf_warning(2, 0.3, 200.0, link, topology)
        assert back_emf_warning(2, 0.3, 200.0, 1.1 * link, topology) == ""
