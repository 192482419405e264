"""Rules of a phase machine compared by losses at points, on a map and over a mission: against the
comparison of the same machine in dq coordinates, and where limits end them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from phase_shapes import paper_machine

from dqforge.machines.design import catalogue
from dqforge.machines.design.design import Design
from dqforge.machines.design.settings import AnyStrategy, LoadPoint, LossSettings
from dqforge.machines.devices.inverter import SwitchDevice
from dqforge.machines.losses.machine_budget import Mission, WindingHeat, read_mission
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.optimizer.losses.drive_budget import PARTS, BudgetOptions
from dqforge.optimizer.losses.drive_comparison import Alternatives
from dqforge.optimizer.losses.loss_map import solve_map
from dqforge.optimizer.losses.phase_comparison import (
    LossComparison,
    PhaseDrive,
    rule_currents,
)
from dqforge.optimizer.losses.solve import mission_comparison, require_losses
from dqforge.reports.losses.map_tables import losses_tables, plain_losses

LIBRARY = catalogue.load("paper002-phase-waveforms")


IGBT = catalogue.load("paper002-pmsm-nonsinusoidal").inverter


# What the dead time costs where a channel carries the current both ways, and a diode meanwhile.
CHANNELS = SwitchDevice("mosfet", 40e-3, 1e-3, 1e-3, 20.0, 300.0, 2.0, diode_voltage=1.2)


POINTS = (LoadPoint(1.0, 78.5), LoadPoint(3.0, 150.0), LoadPoint(-2.0, 100.0))


SINE = PhaseMachine.from_harmonics(
    [1], [0.2233], [0.0], pole_pairs=2, r_s=1.0, l_s=7e-3, m_s=-1e-3, i_max=5.94
)


def _design(
    topology: Topology, machine: PhaseMachine | None = None, points: tuple[LoadPoint, ...] = POINTS
) -> Design:
    """The paper's machine, or another, on a topology with IGBTs."""
    return replace(
        LIBRARY,
        phase_machine=replace(paper_machine(), i_max=5.94) if machine is None else machine,
        inverter=replace(IGBT, topology=topology),
        losses=LossSettings(points, ("mtpa",), ("spwm", "svpwm", "ddt-gdpwm")),
        winding=WindingHeat(1.5),
    )


def _solved(design: Design) -> LossComparison:
    return require_losses(design)


def test_a_sinusoidal_machine_on_three_legs_costs_what_it_costs_in_dq() -> None:
    """Row dq of a phase machine without harmonics beside MTPA of the same in dq coordinates."""
    design = _design("three-wire", SINE)
    waves, plain = _solved(design), _solved(replace(design, phase_machine=None))
    assert waves.strategies == ("dq", "dqx", "limited")
    assert waves.modulations == plain.modulations
    for part in (*PARTS, "total", "junction_temperature", "voltage", "winding_temperature"):
        found, exact = getattr(waves.budget, part)[0], getattr(plain.budget, part)[0]
        # The legs see the ripple here, what switches at its edges most of all, and corners of
        # resting phases lie between angles.
        close = 5e-2 if part == "switching" else 1e-2
        assert found == pytest.approx(exact, rel=close, abs=2e-5)
    assert np.array_equal(waves.usable[0], plain.usable[0])


@pytest.mark.parametrize(
    ("topology", "rules"),
    [
        ("four-leg", ("dq", "dqx", "dqy", "limited")),
        ("six-leg", ("dq", "dqx", "dqy", "limited")),
        ("six-leg-isolated", ("dq", "dqx", "limited")),
        ("split-capacitor", ("dq", "dqx", "dqy", "limited")),
        ("diode-neutral", ("dq", "dqx", "limited")),
    ],
)
def test_every_topology_has_its_rules_and_its_legs(
    topology: Topology, rules: tuple[str, ...]
) -> None:
    """dqy needs a neutral; modulators belong to three legs without one; legs add up to the bridge,
    and the document and the notes name each.
    """
    design = _design(topology)
    design = replace(design, inverter=replace(design.inverter, device=CHANNELS))
    found = _solved(design)
    assert found.strategies == rules
    assert found.legs is not None
    assert len(found.modulations) == (3 if topology == "diode-neutral" else 1)
    bridge = found.budget.conduction + found.budget.switching + found.budget.dead_time
    assert np.max(found.budget.dead_time) > 1e-3
    assert np.sum(found.legs.leg_loss, axis=-1) == pytest.approx(bridge)
    row = plain_losses(found)["rows"][0]  # type: ignore[index]
    assert set(row["legs_W"]) == set(found.legs.legs)
    notes = losses_tables(design, found)[0].notes
    named = [note.split(":")[0] for note in notes if note.startswith("legs with ")]
    assert all(any(rule in note for note in named) for rule in rules)


def test_what_is_out_of_reach_is_said_with_what_is_reached() -> None:
    """Ten newton metres ask for more than the current limit."""
    found = _solved(_design("four-leg", points=(LoadPoint(10.0, 78.5),)))
    assert not np.any(found.reached)
    for s, rule in enumerate(found.strategies):
        if rule != "limited":
            assert 3.9 < found.most[s, 0, 0] < 4.5


@pytest.mark.parametrize("rule", ["dqx", "dqy"])
def test_currents_make_the_torque_up_to_the_current_limit(rule: AnyStrategy) -> None:
    """Mean torque of the machine's own equation; beyond the limit that is the peak."""
    machine = paper_machine()
    design = _design("six-leg", machine)
    for limit, fits in ((5.94, True), (0.3, False)):
        drive = PhaseDrive(machine, design.machine, IGBT, limit, BudgetOptions(), 0.0)
        found, reached = rule_currents(drive, rule, np.array([1.5]), np.array([78.5]), 8e3)
        made = float(np.mean(machine.torque(found[0])))
        assert reached[0] == fits
        if fits:
            assert made == pytest.approx(1.5, rel=1e-9)
        else:
            assert float(np.max(np.abs(found))) == pytest.approx(0.3)


@pytest.mark.parametrize("i_max", [0.3, 5.94])
def test_no_torque_is_reached_by_every_machine(i_max: float) -> None:
    """Without currents there is no limit to meet, however small it is."""
    found = _solved(_design("six-leg", replace(SINE, i_max=i_max), (LoadPoint(0.0, 78.5),)))
    assert np.all(found.reached)


def test_where_the_link_ends_the_limited_currents_go_on() -> None:
    """3.9 N m at 2500 rpm: dqy needs more than 220 V, the currents within all limits do not."""
    fast = _design("four-leg", points=(LoadPoint(3.9, 2500.0 * np.pi / 30.0),))
    fast = replace(fast, inverter=replace(fast.inverter, v_dc=205.0), winding=None)
    found = _solved(fast)
    index = {rule: s for s, rule in enumerate(found.strategies)}
    assert not found.budget.linear[index["dqy"], 0, 0]
    assert found.usable[index["limited"], 0, 0]
    assert found.legs is not None
    assert found.legs.link_demand[index["limited"], 0, 0] <= 205.0 * 0.98 * (1.0 + 1e-6)
    assert found.best_labels[0] is not None
    assert found.best_labels[0][0] == "limited"


def _mission() -> Mission:
    text = (
        "time [s],speed [rpm],torque [N m]\n0,0,1\n1,500,2\n3,1500,3\n6,1500,1\n8,900,-1\n9,0,0\n"
    )
    return read_mission(text.encode("ascii"), "mission.csv", omega_max=None)


ONE = Alternatives(("mtpa",), ("svpwm",), (10e3,))


def test_a_mission_on_three_legs_is_that_of_the_dq_machine() -> None:
    """Energies by kind, work, junctions and winding of the same machine, both ways."""
    design = _design("three-wire", SINE)
    waves = mission_comparison(design, _mission(), ONE, 0.0)
    plain = mission_comparison(replace(design, phase_machine=None), _mission(), ONE, 0.0)
    found, exact = waves.runs[0], plain.runs[0]
    for part in PARTS:
        close = 2e-2 if part == "switching" else 6e-3
        assert found.energy[part] == pytest.approx(exact.energy[part], rel=close, abs=1e-3)
    for name in ("driving", "braking", "input_energy", "junction_max", "winding_temperature"):
        assert getattr(found, name) == pytest.approx(getattr(exact, name), rel=2e-3)
    assert found.missed.size == exact.missed.size == 0


@pytest.mark.parametrize("topology", ["four-leg", "six-leg", "split-capacitor"])
def test_the_energy_of_a_mission_goes_somewhere(topology: Topology) -> None:
    """What the link gives is lost or done at the shaft."""
    for run in mission_comparison(_design(topology), _mission(), ONE, 0.0).runs:
        assert run.input_energy == pytest.approx(run.total + run.driving + run.braking, rel=1e-9)
        assert run.usable


def test_a_map_says_which_rule_loses_least() -> None:
    """Every rule over torque and speed; where all drive, the least is one of them."""
    found = solve_map(_design("four-leg"), ONE, 0.0, 3, 4)
    assert found.comparison.alternatives.strategies == ("dq", "dqx", "dqy", "limited")
    assert found.comparison.best.shape == (12,)
    assert np.all(found.comparison.best >= 0)
    total = np.where(found.usable, found.comparison.budget.total.reshape(4, -1), np.inf)
    chosen = total[found.comparison.best, np.arange(12)]
    assert chosen == pytest.approx(np.min(total, axis=0))
