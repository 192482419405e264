"""Around a regulator in the closed drive: losses of what was counted, the gains that stand for it,
and the pulse patterns that its references can ask for.
"""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from current_feedback_design import feedback_design

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.losses.bridge_tables import BridgeTables, CurrentTable
from dqforge.machines.plants.regulator_schemes import PulsePattern
from dqforge.optimizer.current_feedback import closed_drive
from dqforge.optimizer.current_feedback.closed_drive import (
    counted_losses,
    iron_losses,
    lag_gains,
    least_pattern_speed,
    not_run,
    pattern_table,
)
from dqforge.optimizer.current_feedback.regulator_runs import regulator_plan
from dqforge.optimizer.losses.drive_budget import switched_iron
from dqforge.optimizer.losses.loss_map import budget_options
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus

KNOTS = np.array([25.0, 125.0])
TOP, PLACES, TIME = 30.0, 7, 0.4


def table(cold: float, warm: float, bend: float = 0.0) -> CurrentTable:
    """From ``bend`` at no current on, by so much per ampere at each temperature."""
    current = np.array([0.0, 10.0, 1e3])
    return CurrentTable(current, bend + np.outer([cold, warm], current))


def device(*, synchronous: bool, separate: bool, diode: bool = True) -> BridgeTables:
    return BridgeTables(
        temperatures=KNOTS,
        synchronous=synchronous,
        separate_diode=separate,
        channel=table(0.02, 0.05, 0.7),
        diode=table(0.03, 0.02, 1.1) if diode else None,
        turn_on=table(2e-5, 3e-5),
        turn_off=table(1e-5, 4e-5, 1e-5),
        recovery=table(3e-5, 5e-5),
        resistances=(0.4, 0.7, 0.2) if separate else (0.6, 0.2),
        coolant_temperature=60.0,
        max_junction_temperature=175.0,
        current_reach=1e3,
        temperature_reach=(25.0, 125.0),
    )


def counted() -> FloatArray:
    """Times in s and numbers by chance, of which the upper position has more."""
    drawn = np.random.default_rng(8).uniform(0.2, 1.0, (2, 5, PLACES))
    drawn[:, :3] *= TIME / PLACES
    drawn[:, 3:] *= 300.0
    drawn[1] *= 0.6
    return np.asarray(drawn)


@pytest.mark.parametrize(
    ("synchronous", "separate", "diode"),
    [
        (False, False, True),
        (False, True, True),
        (True, False, True),
        (True, True, True),
        (True, False, False),
    ],
)
def test_counted_losses_are_those_of_every_place_at_the_temperature_that_they_make(
    *, synchronous: bool, separate: bool, diode: bool
) -> None:
    """Place by place, and the temperatures by going round until they rest: the other position's
    diode recovers, a channel carries what returns, and a dead time is the diode's."""
    tables, times = device(synchronous=synchronous, separate=separate, diode=diode), counted()
    found = counted_losses(tables, times, TOP, TIME)

    places = TOP * np.arange(PLACES) / (PLACES - 1)

    def at(one: CurrentTable, t: float) -> FloatArray:
        cold, warm = (np.interp(places, one.current, row) for row in one.value)
        return np.asarray(cold + (t - 25.0) / 100.0 * (warm - cold))

    beside = tables.diode or tables.channel  # a channel alone takes the dead times, too
    heat = np.full((2, 2), 60.0)  # upper and lower; transistor and diode
    for _ in range(40):
        parts = np.zeros((3, 2, 2))
        for side in range(2):
            transistor, own = heat[side]
            carries, returns, blanked, on, off = times[side] / (3.0 * TIME)
            parts[0, side, 0] = carries * places @ at(tables.channel, transistor)
            back = returns * places
            if synchronous:
                parts[0, side, 0] += back @ at(tables.channel, transistor)
            else:
                parts[0, side, 1] = back @ at(beside, own)
            parts[1, side, 1] = blanked * places @ at(beside, own)
            parts[2, side, 0] = on @ at(tables.turn_on, transistor)
            parts[2, side, 0] += off @ at(tables.turn_off, transistor)
            parts[2, 1 - side, 1] = on @ at(tables.recovery, heat[1 - side, 1])
        power = np.sum(parts, axis=0)
        both = np.sum(power, axis=1, keepdims=True)
        if separate:
            heat = 60.0 + 0.2 * both + power * np.array([0.4, 0.7])
        else:
            heat = 60.0 + 0.8 * np.repeat(both, 2, axis=1)
    conduction, blanked, switching = 3.0 * np.sum(parts, axis=(1, 2))
    assert found.conduction == pytest.approx(conduction + blanked, rel=1e-7)
    assert found.blanked == pytest.approx(blanked, rel=1e-7)
    assert found.switching == pytest.approx(switching, rel=1e-7)
    assert found.junction_temperature == pytest.approx(float(np.max(heat[:, 0])), rel=1e-7)
    assert found.junction_temperature > 64.0


@pytest.mark.parametrize("bandwidth", [None, 700.0])
def test_gains_of_the_current_loops_stand_for_a_lag(bandwidth: float | None) -> None:
    """kp = bandwidth L and ki = bandwidth R of either axis, so that both close as one lag."""
    design = feedback_design("hysteresis")
    lag = None if bandwidth is None else SimpleNamespace(bandwidth=bandwidth)
    plan = SimpleNamespace(method="hysteresis")
    own: Any = SimpleNamespace(plan=plan, equivalent=lag, speed=None)
    gains = lag_gains(design, own)
    wanted = 0.3 / design.control.t_s if bandwidth is None else bandwidth
    for loop, name, inductance in ((gains.i_d, "i_d", 4e-3), (gains.i_q, "i_q", 6e-3)):
        assert (loop.loop, loop.method) == (name, "hysteresis")
        assert loop.kp == pytest.approx(wanted * inductance)
        assert loop.ki == pytest.approx(wanted * 0.8)
    assert gains.speed is None


def test_patterns_are_those_of_the_fundamentals_that_references_need(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every number of pulses over the speeds that the carrier leaves it, every step of the voltage
    of both signs of the torque there; by a dense set of currents and speeds."""
    design = feedback_design("trajectory")
    plan = replace(regulator_plan(design), carrier=3e3, pulses=9)
    asked: list[tuple[int, int, int]] = []

    def noted(angles: int, first: int, last: int) -> list[Any]:
        asked.append((angles, first, last))
        return []

    monkeypatch.setattr(closed_drive, "_patterns_between", noted)
    least = least_pattern_speed(design, plan)
    assert 400.0 / (8.0 * 4e-3 * 9 * least / (2.0 * math.pi)) == pytest.approx(2.0 * 10.0)
    top = 2.0 * math.pi * 700.0
    assert pattern_table(design, plan, top) == []
    locus = mtpa_locus(design.machine, design.i_max)
    expected = []
    for angles in (1, 2, 3, 4):
        # so many pulses and two more would take more than the carrier
        low = 0.9 * least if angles == 4 else 2.0 * math.pi * 3e3 / (2 * angles + 3)
        high = top if angles == 1 else 2.0 * math.pi * 3e3 / (2 * angles + 1)
        low = max(low, 0.9 * least)
        if low >= min(high, top):
            continue
        speed = np.linspace(low, min(high, top), 40)[:, None]
        volts = [
            np.hypot(
                0.8 * locus.i_d - speed * 6e-3 * sign * locus.i_q,
                0.8 * sign * locus.i_q + speed * (0.1 + 4e-3 * locus.i_d),
            )
            for sign in (1.0, -1.0)
        ]
        steps = np.array(volts) / 200.0 / 0.1
        expected.append((angles, max(1, math.floor(steps.min())), math.ceil(steps.max())))
    assert len(expected) >= 3
    assert asked == expected


def test_patterns_between_two_steps_are_sought_from_their_neighbours(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Every third is sought by itself, until one is beyond what angles make; those between begin
    where the two beside them lie, and what none leads to is left out."""
    sought: list[float] = []
    led: dict[float, list[float]] = {}

    def best(angles: int, index: float) -> PulsePattern:
        sought.append(index)
        if index > 1.25:
            raise NoSolutionError("beyond")
        return PulsePattern(np.full(angles, index), 1)

    def continued(near: list[PulsePattern], index: float) -> PulsePattern | None:
        led[index] = [float(pattern.angles[0]) for pattern in near]
        return PulsePattern(np.full(2, index), -1) if index < 1.15 else None

    monkeypatch.setattr(closed_drive, "optimal_pattern", best)
    monkeypatch.setattr(closed_drive, "continued_pattern", continued)
    found = closed_drive._patterns_between(2, 4, 8)
    assert sought == pytest.approx([0.4, 0.7, 1.0])
    assert [float(pattern.angles[0]) for pattern in found] == pytest.approx(
        [0.4, 0.5, 0.6, 0.7, 0.8]
    )
    assert [pattern.sign for pattern in found] == [1, -1, -1, 1, -1]
    assert list(led) == pytest.approx([0.5, 0.6, 0.8])
    assert list(led.values()) == [pytest.approx(x) for x in ([0.4, 0.7], [0.4, 0.7], [0.7, 1.0])]
    sought.clear()
    found = closed_drive._patterns_between(2, 8, 16)
    assert sought == pytest.approx([0.8, 1.1, 1.4])
    assert [float(pattern.angles[0]) for pattern in found] == pytest.approx([0.8, 0.9, 1.0, 1.1])
    assert led[12 * 0.1] == pytest.approx([1.1])


def test_a_point_that_was_not_run_has_no_number_but_its_reason() -> None:
    point = not_run("circle", "too fast")
    assert (point.name, point.obstacle) == ("circle", "too fast")
    assert math.isnan(point.total)
    assert math.isnan(point.torque)
    whole = replace(
        point, copper=1.0, ripple_copper=2.0, iron=4.0, ripple_iron=8.0, conduction=16.0,
        switching=32.0,
    )  # fmt: skip
    assert whole.total == 63.0


def test_iron_losses_are_those_of_flux_and_voltage() -> None:
    """Hysteresis with the frequency, eddy currents with its square, both with that of the flux; of
    the switching what eddy currents of its voltages lose."""
    design = feedback_design(
        "hysteresis",
        "machine.iron_loss={frequency: 100 Hz, flux: {value: 0.2 Wb, kind: peak}, hysteresis: 5 W,"
        " eddy: 8 W}",
    )
    iron, ripple = iron_losses(design, -3.0, 4.0, 300.0, 9e3)
    psi = np.hypot(0.1 - 3.0 * 4e-3, 4.0 * 6e-3) / 0.2
    turns = 900.0 / (2.0 * math.pi * 100.0)
    assert iron == pytest.approx(psi**2 * (5.0 * turns + 8.0 * turns**2), rel=1e-9)
    voltage = np.hypot(-3.0 * 0.8 - 900.0 * 24e-3, 4.0 * 0.8 + 900.0 * 88e-3)
    own = switched_iron(budget_options(design), voltage, 400.0, np.array([9e3]))
    assert ripple == pytest.approx(float(own[0]), rel=1e-9)
    assert 0.0 < ripple != pytest.approx(iron_losses(design, -3.0, 4.0, 250.0, 9e3)[1], rel=1e-3)
