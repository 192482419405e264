"""What to flash: the recommendation turns with the switches, and rows say why they cannot be."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from phase_shapes import paper_machine, trapezoid_machine

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.devices.inverter import SwitchDevice
from dqforge.machines.errors import InputError
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.flashing_choice import (
    DEVIATIONS,
    advise,
    compare_flashing,
    pointwise_dq,
)

P = catalogue.load("paper002-phase-waveforms")


IGBT = catalogue.load("paper002-pmsm-nonsinusoidal").inverter


MOSFET = replace(IGBT, device=SwitchDevice("mosfet", 40e-3, 0.0, 0.0, 20.0, 300.0, 2.0))


def _drive(machine: PhaseMachine, inverter: object = IGBT, torque: float = 3.9) -> Design:
    return replace(
        P,
        phase_machine=machine,
        inverter=inverter,  # type: ignore[arg-type]
        waveform=replace(P.waveform, torque=torque),
    )


def test_with_igbts_the_star_is_flashed_and_the_watts_are_named() -> None:
    """Copper saved, what the leg costs, and the balance, at 3.9 N m of the paper's machine."""
    found = compare_flashing(_drive(paper_machine()))
    advice = advise(found)
    assert advice.row is not None
    assert (advice.row.topology, advice.row.frame) == ("three-wire", "table")
    for trade in advice.trades:
        row, best = found.row(trade.topology, "table"), advice.row
        assert trade.copper_saved == pytest.approx(best.copper - row.copper, rel=1e-12)
        assert trade.link_saved == pytest.approx(best.link - row.link, rel=1e-12)
        lost = (row.bridge - best.bridge) - (best.copper - row.copper)
        assert trade.net == pytest.approx(-lost, rel=1e-9)
    fourth = next(trade for trade in advice.trades if trade.topology == "four-leg")
    assert fourth.copper_saved == pytest.approx(0.69, abs=0.02)
    assert fourth.neutral_leg == pytest.approx(1.98, abs=0.03)
    assert fourth.net == pytest.approx(-1.68, abs=0.04)
    six = next(trade for trade in advice.trades if trade.topology == "six-leg")
    assert six.net == pytest.approx(-18.4, abs=0.5)
    assert six.link_saved > 30.0
    assert advice.dq_ripple > 5.0 * advice.row.ripple.plain  # type: ignore[union-attr]


@pytest.mark.parametrize(
    ("machine", "gain"), [(paper_machine(), 0.5), (trapezoid_machine(), 1.5)], ids=["P", "Z"]
)
def test_with_small_mosfets_the_fourth_leg_pays(machine: PhaseMachine, gain: float) -> None:
    """40 mOhm: the copper is worth more than the channels; the star is then what would cost."""
    advice = advise(compare_flashing(_drive(machine, MOSFET)))
    assert advice.row is not None
    assert (advice.row.topology, advice.row.frame) == ("four-leg", "table")
    star = next(trade for trade in advice.trades if trade.topology == "three-wire")
    assert -2.0 < star.net < -gain


def test_without_a_device_nothing_is_said_of_the_inverter() -> None:
    """The fewest legs are named, and what others cost is unknown."""
    found = compare_flashing(_drive(paper_machine(), replace(IGBT, device=None)))
    advice = advise(found)
    assert found.without_device
    assert advice.row is not None
    assert advice.row.topology == "three-wire"
    assert all(math.isnan(trade.net) for trade in advice.trades)
    assert all(trade.copper_saved != 0.0 for trade in advice.trades)


def test_a_sinusoidal_machine_needs_no_table() -> None:
    """The third harmonic is gone, and dq is as smooth."""
    sine = PhaseMachine.from_harmonics(
        [1, 5], [0.2233, 1e-6], [0.0, 0.0], pole_pairs=2, r_s=1.0, l_s=7e-3, m_s=-1e-3, i_max=14.0
    )
    advice = advise(compare_flashing(_drive(sine, replace(IGBT, dead_time=0.0))))
    assert advice.row is not None
    assert (advice.row.topology, advice.row.frame) == ("three-wire", "dq")


def test_where_the_link_ends_more_legs_are_named() -> None:
    """At 120 V the star cannot make 1800 rpm; six legs can."""
    drive = _drive(paper_machine(), replace(IGBT, v_dc=120.0))
    drive = replace(drive, waveform=replace(drive.waveform, omega_m=1800.0 * math.pi / 30.0))
    found = compare_flashing(drive)
    advice = advise(found)
    assert "the link ends at 120 V" in found.row("three-wire", "table").obstacle
    assert advice.row is not None
    assert advice.row.topology == "six-leg"


def test_nothing_is_flashed_where_nothing_fits() -> None:
    """A link of 20 V drives none of them."""
    advice = advise(compare_flashing(_drive(paper_machine(), replace(IGBT, v_dc=20.0))))
    assert advice.row is None
    assert advice.trades == ()


def test_every_row_has_every_figure() -> None:
    """Fifteen rows, each with the ripple as it is and with every deviation."""
    found = compare_flashing(_drive(paper_machine()))
    assert len(found.rows) == 15
    for row in found.rows:
        assert row.ripple is not None
        assert set(row.ripple.deviating) == set(DEVIATIONS)
        # An error of a sensor is never smoother; an inductance or a back-EMF may be.
        assert min(row.ripple.deviating[name] for name in ("offset", "noise")) > row.ripple.plain
        assert row.constants >= 4 * 97
        assert row.control is not None
        assert (row.control.harmonics is not None) == (row.frame == "table")
    assert found.row("split-capacitor", "dqy").neutral > found.row("four-leg", "dqy").neutral


def test_a_point_at_rest_is_refused() -> None:
    """Ripple over an electrical period needs one."""
    drive = _drive(paper_machine())
    for still in (replace(drive.waveform, torque=0.0), replace(drive.waveform, omega_m=0.0)):
        with pytest.raises(InputError, match="--flash"):
            compare_flashing(replace(drive, waveform=still))


@pytest.mark.slow
def test_a_salient_machine_has_dq_and_the_table() -> None:
    """Its other frames are refused with the reason. The table makes no use of the saliency: it is
    smoother than dq, whose MTPA loses less, and that is said.
    """
    drive = catalogue.load("salient-phase-waveforms")
    drive = replace(drive, inverter=replace(drive.inverter, v_dc=250.0, topology="four-leg"))
    found = compare_flashing(drive)
    advice = advise(found)
    assert "inductances that do not vary" in found.row("three-wire", "dqx").obstacle
    plain, table = (found.row("three-wire", frame) for frame in ("dq", "table"))
    assert advice.row is table
    assert table.losses > plain.losses
    assert advice.dq_saved == pytest.approx(table.losses - plain.losses)
    assert plain.ripple is not None
    assert table.ripple is not None
    assert table.ripple.plain < plain.ripple.plain


@pytest.mark.parametrize("torque", [0.6, -0.9])
def test_sinusoids_of_a_salient_machine_are_its_mtpa(torque: float) -> None:
    """Constant in dq, of that torque with the sign of i_q, and no neighbour on it is smaller."""
    drive = catalogue.load("salient-phase-waveforms")
    machine = drive.phase_machine
    assert machine is not None
    currents = pointwise_dq(drive, torque, machine)
    angle = 2.0 * np.pi * np.arange(machine.angles) / machine.angles
    shifted = angle - 2.0 * np.pi / 3.0 * np.arange(3)[:, None]
    i_d = 2.0 / 3.0 * np.sum(currents * np.cos(shifted), axis=0)
    i_q = -2.0 / 3.0 * np.sum(currents * np.sin(shifted), axis=0)
    np.testing.assert_allclose(i_d, i_d[0], atol=1e-9)
    np.testing.assert_allclose(i_q, i_q[0], rtol=1e-9)
    assert np.all(np.abs(np.sum(currents, axis=0)) < 1e-9)
    linear = drive.machine
    assert float(linear.torque(i_d[:1], i_q[:1])[0]) == pytest.approx(torque, rel=1e-9)
    beside = i_d[0] + np.array([-1e-2, 1e-2])
    per_ampere = linear.torque(beside, np.ones(2))
    assert np.all(np.hypot(beside, torque / per_ampere) > np.hypot(i_d[0], i_q[0]))
    assert abs(i_d[0]) > 1e-3
