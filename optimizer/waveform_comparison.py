"""Phase currents of a design's machine by every rule, side by side at one operating point."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from dqforge.machines.design import Design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.inverter import Topology
from dqforge.machines.numerical import on_design
from dqforge.machines.phase_machine import PhaseMachine
from dqforge.machines.settings import WaveformSettings
from dqforge.machines.synchronous import FloatArray
from dqforge.optimizer.characteristics import limit_speed
from dqforge.optimizer.phase_currents import CurrentRule, WaveformFigures, figures, unit_currents
from dqforge.optimizer.waveform_problem import LIMITS, WaveformLimits
from dqforge.optimizer.waveform_solver import require_solution, ripple_front, solve_waveforms

Rule = Literal["dq", "dqx", "dqy", "limited"]

_EXACT = 1e-6

FRONT_RIPPLES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2)
"""Permitted deviations of the torque from its mean, relative, at which the price of smoothness is shown."""


@dataclass(frozen=True, slots=True)
class RuleCurrents:
    """Phase currents of one rule.

    ``currents`` in A, shape (3, N); ``torque`` in N m, shape (N,); ``figures`` hold arrays of shape (1,). ``obstacles``
    names what the currents break: no neutral for the zero sequence, the current limit, or the dc link.
    """

    rule: Rule
    currents: FloatArray
    torque: FloatArray
    figures: WaveformFigures
    obstacles: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class WaveformComparison:
    """Rules at one operating point; ``limited`` is the last, with the least copper loss that all limits permit.

    ``binding`` names the limits that hold it; ``impossible`` lists rules without currents, each with the reason.
    ``front`` are pairs of a permitted deviation of the torque, relative, and the least copper loss with it in W, NaN
    where there is none.
    """

    machine: PhaseMachine
    torque: float
    omega_m: float
    limits: WaveformLimits
    rules: tuple[RuleCurrents, ...]
    binding: tuple[str, ...]
    impossible: tuple[tuple[CurrentRule, str], ...]
    front: tuple[tuple[float, float], ...]


def require_phases(design: Design) -> PhaseMachine:
    """The machine in phase quantities.

    Raises
    ------
    InputError
        The design's machine has a sinusoidal back-EMF.
    """
    if design.phase_machine is None:
        raise InputError(
            "this design's machine has a sinusoidal back-EMF; phase currents are shaped for model: waveform, "
            "see 'dqforge machines paper002-phase-waveforms'"
        )
    return design.phase_machine


def limits_of(design: Design, settings: WaveformSettings, torque: float) -> WaveformLimits:
    """Limits of the design's inverter and settings; the ripple is relative to the torque."""
    return WaveformLimits(
        v_dc=design.inverter.v_dc,
        topology=design.inverter.topology,
        i_max=design.i_max,
        ripple=settings.ripple * abs(torque),
        neutral=settings.neutral,
        open_phase=settings.open_phase,
        slew=settings.slew,
    )


def operating_point(design: Design, settings: WaveformSettings) -> tuple[float, float]:
    """Torque in N m and mechanical speed in rad/s: as set, or that of dq at the current limit, and the base speed."""
    torque, omega_m = settings.torque, settings.omega_m
    if torque is None:
        torque = design.machine.torque_per_ampere * design.i_max
    if omega_m is None:
        current = torque / design.machine.torque_per_ampere
        speed = limit_speed(design.machine, np.zeros(1), np.array([current]), design.inverter.v_dc / math.sqrt(3.0))
        omega_m = float(speed[0])
    return torque, omega_m


@on_design("waveform")
def compare_waveforms(design: Design, settings: WaveformSettings | None = None) -> WaveformComparison:
    """Phase currents by dq, dqx, dqy, and within all limits, at one operating point.

    Raises
    ------
    InputError
        The machine has a sinusoidal back-EMF.
    NoSolutionError
        No currents keep the limits; says what would have to give.
    """
    machine = require_phases(design)
    settings = design.waveform if settings is None else settings
    torque, omega_m = operating_point(design, settings)
    limits = limits_of(design, settings, torque)
    rules, impossible = [], []
    for rule in get_args(CurrentRule):
        try:
            currents = torque * unit_currents(machine, rule)
        except NoSolutionError as error:
            impossible.append((rule, str(error)))
            continue
        rules.append(_judged(machine, rule, currents, omega_m, limits))
    found = solve_waveforms(machine, torque, omega_m, limits)
    require_solution(machine, found, limits)
    rules.append(_judged(machine, "limited", found.currents[0], omega_m, limits))
    binding = tuple(name for name, binds in zip(LIMITS, found.binding[0], strict=True) if binds)
    losses = _front(machine, torque, omega_m, limits)
    front = tuple(zip(FRONT_RIPPLES, losses.tolist(), strict=True))
    return WaveformComparison(machine, torque, omega_m, limits, tuple(rules), binding, tuple(impossible), front)


def _front(machine: PhaseMachine, torque: float, omega_m: float, limits: WaveformLimits) -> FloatArray:
    """Least copper loss in W over `FRONT_RIPPLES`; NaN where no currents keep the limits, or none make it constant."""
    ripples = np.array(FRONT_RIPPLES) * abs(torque)
    constant = ripples == 0.0
    try:
        first = ripple_front(machine, torque, omega_m, limits, ripples[constant])
    except NoSolutionError:
        first = np.full(np.count_nonzero(constant), np.nan)
    return np.concatenate([first, ripple_front(machine, torque, omega_m, limits, ripples[~constant])])


def _judged(
    machine: PhaseMachine, rule: Rule, currents: FloatArray, omega_m: float, limits: WaveformLimits
) -> RuleCurrents:
    """Currents with their figures and what they break."""
    found = figures(machine, currents[np.newaxis], np.array([omega_m]), limits.topology)
    obstacles = []
    if _has_no_neutral(limits.topology) and found.neutral_rms[0] > _EXACT * found.rms[0]:
        obstacles.append("needs the neutral")
    if found.peak[0] > limits.i_max * (1.0 + _EXACT):
        obstacles.append("current limit")
    if found.bus[0] > limits.v_dc * (1.0 + _EXACT):
        obstacles.append("dc link")
    if limits.open_phase is not None and np.any(currents["abc".index(limits.open_phase)]):
        obstacles.append("open phase")
    return RuleCurrents(rule, currents, machine.torque(currents), found, tuple(obstacles))


def _has_no_neutral(topology: Topology) -> bool:
    return topology == "three-wire"


def with_point(
    settings: WaveformSettings, torque: float | None, omega_m: float | None, ripple: float | None, phase: str | None
) -> WaveformSettings:
    """Settings in which what is given replaces what was set.

    Raises
    ------
    InputError
        The open phase is none of a, b and c, or the ripple is no share.
    """
    if phase is not None and phase not in ("a", "b", "c"):
        raise InputError(f"--open-phase: expected a, b or c, got '{phase}'")
    if ripple is not None and not 0.0 <= ripple < 1.0:
        raise InputError(f"--ripple: expected a share below 100 % such as '5 %', got {100.0 * ripple:g} %")
    given = {"torque": torque, "omega_m": omega_m, "ripple": ripple, "open_phase": phase}
    changes = {key: value for key, value in given.items() if value is not None}
    return replace(settings, **changes)  # type: ignore[arg-type]
