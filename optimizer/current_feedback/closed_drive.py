"""A regulator that switches the bridge, in the closed drive: the speed loop and references around
it, and the losses of a bridge whose currents and commutations were counted.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import NoSolutionError
from dqforge.machines.losses.bridge_tables import BridgeTables, at_temperature, junction_balance
from dqforge.machines.losses.machine_budget import machine_budget
from dqforge.machines.plants.regulator_schemes import (
    PulsePattern,
    continued_pattern,
    optimal_pattern,
)
from dqforge.machines.records import dataclass
from dqforge.optimizer.control_design.gain_set import GainSet, per_unit_of
from dqforge.optimizer.current_feedback.regulator_runs import (
    CALM,
    CurrentFeedback,
    RegulatorPlan,
    emitted_rule,
    regulator_plan,
    run_regulator,
    speed_loop,
    speed_points,
)
from dqforge.optimizer.loops.loop_gains import LoopGains, analyse_current_loop
from dqforge.optimizer.losses.drive_budget import switched_iron
from dqforge.optimizer.losses.loss_map import budget_options
from dqforge.optimizer.operating_points.mtpa_locus import mtpa_locus

# What is counted of a switch position, in the order of the compiled simulation.
COUNTED = ("carries", "returns", "blanked", "turns_on", "turns_off")


def own_feedback(design: Design) -> CurrentFeedback:
    """The design's regulator alone with the speed loop over it, the others left out.

    Raises:
        InputError, NoSolutionError: As `run_regulator` and `speed_loop`.
    """
    plan = regulator_plan(design)
    run = run_regulator(design, plan, speed_points(design))
    found = speed_loop(design, run)
    own = CurrentFeedback(
        plan=plan,
        over_speed=(run,),
        own=0,
        loads=None,
        equivalent=None if found is None else found[0],
        speed=None if found is None else found[1],
        rule=emitted_rule(design, plan),
    )
    return replace(own, gains=lag_gains(design, own))


def lag_gains(design: Design, found: CurrentFeedback) -> GainSet:
    """Gains of the speed loop, over current loops that stand for the regulator.

    The emitted speed control takes the torque and both references from them; its duty cycles, which
    current loops with these gains would make, are left aside.
    """
    machine, control = linearised(design.machine), design.control
    bandwidth = CALM / control.t_s if found.equivalent is None else found.equivalent.bandwidth
    loops: list[LoopGains] = [
        analyse_current_loop(
            machine.r_s,
            inductance,
            control.t_s,
            bandwidth * inductance,
            bandwidth * machine.r_s,
            found.plan.method,
            respond=False,
        )
        for inductance in (machine.l_d, machine.l_q)
    ]
    i_d, i_q = replace(loops[0], loop="i_d"), loops[1]
    return GainSet(i_d, i_q, found.speed, per_unit_of(control, (i_d, i_q, None, found.speed)), None)


@dataclass(frozen=True, slots=True)
class CountedLosses:
    """Losses of a bridge in W, all legs, at the junction temperatures that they lead to.

    ``blanked`` is the part of the conduction during dead times; ``junction_temperature`` in degC is
    the highest of a transistor, where the device has a thermal resistance the coolant's plus its
    rise.
    """

    conduction: float
    blanked: float
    switching: float
    junction_temperature: float


def counted_losses(
    tables: BridgeTables, counted: FloatArray, top: float, duration: float
) -> CountedLosses:
    """Losses from times and commutations counted over an even grid of currents.

    Args:
        tables: The device.
        counted: Upper and lower position; `COUNTED`; places of the grid: shape (2, 5, B), in s and
            in numbers, all three legs together.
        top: Current in A of the last place; that of the first is 0.
        duration: Time in s in which it was counted, positive.
    """
    size = np.linspace(0.0, top, counted.shape[-1])
    per_leg = counted / (3.0 * duration)
    carries, returns, blanked, turns_on, turns_off = np.moveaxis(per_leg, 1, 0)
    channel = tables.channel.at(size) * size
    diode = channel if tables.diode is None else tables.diode.at(size) * size
    back = channel if tables.synchronous else diode
    conduction, dead, switching = np.zeros((3, 2, 2, tables.temperatures.size))
    conduction[:, 0] = carries @ channel.T
    conduction[:, 0 if tables.synchronous else 1] += returns @ back.T
    dead[:, 1] = blanked @ diode.T
    switching[:, 0] = turns_on @ tables.turn_on.at(size).T + turns_off @ tables.turn_off.at(size).T
    switching[::-1, 1] = turns_on @ tables.recovery.at(size).T
    parts = [
        part if tables.separate_diode else np.sum(part, axis=1, keepdims=True)
        for part in (conduction, dead, switching)
    ]
    heat = junction_balance(tables, sum(parts, np.zeros_like(parts[0]))[..., None])
    watts = [
        3.0
        * float(
            np.sum(
                at_temperature(tables.temperatures, part[..., None], heat.temperature), axis=(0, 1)
            )[0]
        )
        for part in parts
    ]
    return CountedLosses(
        conduction=watts[0] + watts[1],
        blanked=watts[1],
        switching=watts[2],
        junction_temperature=float(np.max(heat.temperature[:, 0])),
    )


# Ripple v_dc / (8 L f) over the current limit up to which patterns are followed, which leave about
# a fifth of it; and the step of the fundamental over half the link between patterns of a table.
_RIPPLE = 2.0
_STEP = 0.1
_THIRD = 3


def least_pattern_speed(design: Design, plan: RegulatorPlan) -> float:
    """Electrical speed in rad/s below which comparators switch in place of patterns.

    There the ripple v_dc / (8 L f) of the most pulses is twice the current limit.
    """
    machine = linearised(design.machine)
    ripple = _RIPPLE * design.i_max * 8.0 * min(machine.l_d, machine.l_q)
    return 2.0 * math.pi * design.inverter.v_dc / ripple / plan.pulses


def pattern_table(design: Design, plan: RegulatorPlan, omega_e: float) -> list[PulsePattern]:
    """Patterns that the references can ask for up to an electrical speed in rad/s.

    By their numbers of angles, and by the fundamental in steps of a tenth of half the link; those
    that no switching angles make are left out.
    """
    machine = linearised(design.machine)
    locus = mtpa_locus(machine, design.i_max)
    i_d, i_q = (np.concatenate([part, part]) for part in (locus.i_d, locus.i_q))
    i_q[: locus.i_q.size] *= -1.0
    least, found = 0.9 * least_pattern_speed(design, plan), []
    most = (plan.pulses - 1) // 2
    for angles in range(1, most + 1):
        low = (
            max(least, 2.0 * math.pi * plan.carrier / (2 * angles + 3)) if angles < most else least
        )
        ends = [low, min(omega_e, 2.0 * math.pi * plan.carrier / (2 * angles + 1))]
        if angles == 1:
            ends[1] = omega_e
        if ends[0] >= ends[1]:
            continue
        index = np.hypot(*machine.voltage(i_d, i_q, np.array(ends)[:, None])) / (
            0.5 * design.inverter.v_dc
        )
        first, last = math.floor(np.min(index) / _STEP), math.ceil(np.max(index) / _STEP)
        found += _patterns_between(angles, max(first, 1), last)
    return found


def _patterns_between(angles: int, first: int, last: int) -> list[PulsePattern]:
    """Patterns of some angles from one step of the fundamental to another: every third by itself,
    those between from their neighbours.
    """
    own: dict[int, PulsePattern] = {}
    for step in range(first, last + _THIRD, _THIRD):
        try:
            own[step] = optimal_pattern(angles, step * _STEP)
        except NoSolutionError:
            break
    every: list[PulsePattern] = []
    for step in range(first, last + 1):
        near = [pattern for place, pattern in own.items() if abs(place - step) < _THIRD]
        found = own.get(step) or continued_pattern(near, step * _STEP)
        if found is not None:
            every.append(found)
    return every


@dataclass(frozen=True, slots=True)
class ClosedPoint:
    """A regulator, or the carrier, at one load in the closed drive; powers in W.

    Args:
        name: The method, or the modulator.
        torque, omega_m: Means in N m and rad/s.
        speed_error: Mean speed less its reference in rad/s.
        frequency: Switching frequency of a leg in Hz.
        distortion: Of the phase currents over their fundamental.
        torque_ripple: R.m.s. in N m.
        copper, ripple_copper: Of the fundamental, and of what the currents have beside it.
        iron, ripple_iron: Of the fundamental, and what the switching makes by its frequency.
        conduction, switching: Of the bridge, dead times included.
        obstacle: Why it could not be run, or an empty text; the numbers then are NaN.
    """

    name: str
    torque: float
    omega_m: float
    speed_error: float
    frequency: float
    distortion: float
    torque_ripple: float
    copper: float
    ripple_copper: float
    iron: float
    ripple_iron: float
    conduction: float
    switching: float
    obstacle: str = ""

    @property
    def total(self) -> float:
        """Sum of the losses in W."""
        return (
            self.copper + self.ripple_copper + self.iron + self.ripple_iron
            + self.conduction + self.switching
        )  # fmt: skip


def not_run(name: str, reason: str) -> ClosedPoint:
    """A point that could not be run."""
    return ClosedPoint(name, *(math.nan,) * 12, obstacle=reason)


def iron_losses(
    design: Design, i_d: float, i_q: float, omega_m: float, frequency: float
) -> tuple[float, float]:
    """Iron loss in W of the fundamental (magnets included), and that which the switching makes.

    Args:
        design: Machine, its loss and the link.
        i_d, i_q: Mean currents in A.
        omega_m, frequency: Mechanical speed in rad/s, switching frequency of a leg in Hz.
    """
    options, machine = budget_options(design), design.machine
    d, q, omega = (np.array([value]) for value in (i_d, i_q, omega_m))
    found = machine_budget(machine, d, q, omega, loss=options.machine_loss, heat=options.winding)
    voltage = np.hypot(*machine.voltage(d, q, machine.pole_pairs * omega))
    ripple = switched_iron(options, voltage, design.inverter.v_dc, np.array([frequency]))
    return float(found.iron[0] + found.magnet[0]), float(ripple[0])
