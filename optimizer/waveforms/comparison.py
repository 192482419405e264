"""Phase currents of a design's machine by every rule, side by side at one operating point."""

from __future__ import annotations

import contextlib
import math
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import WaveformSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, between
from dqforge.machines.phase_machines.salient_phase_machine import (
    AnyPhaseMachine,
    SalientPhaseMachine,
)
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.regions import sine_share
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.operating_points.characteristics import limit_speed
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.waveforms.confirmation import Confirmation, confirm_waveforms
from dqforge.optimizer.waveforms.constraint_rows import LIMITS, WaveformLimits
from dqforge.optimizer.waveforms.open_phase import OpenPhasePrice, open_phase_price
from dqforge.optimizer.waveforms.phase_currents import (
    CurrentRule,
    WaveformFigures,
    dq_waveform,
    figures,
    spectrum,
    unit_currents,
)
from dqforge.optimizer.waveforms.pointwise_currents import pointwise_currents
from dqforge.optimizer.waveforms.salient_solver import SalientWaveforms, solve_salient
from dqforge.optimizer.waveforms.solver import WaveformSolutions, require_solution, solve_waveforms

Rule = Literal["dq", "dqx", "dqy", "limited"]
_EXACT = 1e-6

# Permitted deviations of the torque from its mean, relative, at which the price of smoothness is
# shown.
FRONT_RIPPLES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2)


@dataclass(frozen=True, slots=True)
class RuleCurrents:
    """Phase currents of one rule.

    ``currents`` in A, shape (3, N); ``torque`` in N m, shape (N,); ``figures`` hold arrays of shape
    (1,). ``obstacles`` names what the currents break: no neutral for the zero sequence, the current
    limit, or the dc link. ``harmonics`` are the amplitudes of the currents in A (peak), shape (3,
    H), of ``orders`` of the electrical angle, shape (H,): 0, 1, 2 and so on, or multiples of a part
    where the waveforms span several electrical periods.
    """

    rule: Rule
    currents: FloatArray
    torque: FloatArray
    figures: WaveformFigures
    obstacles: tuple[str, ...]
    harmonics: FloatArray
    orders: FloatArray


@dataclass(frozen=True, slots=True)
class WaveformComparison:
    """Rules at one operating point.

    ``limited`` is the last, with the least copper loss that all limits permit.

    ``binding`` names the limits that hold it; ``impossible`` lists rules without currents, each
    with the reason. ``front`` are pairs of a permitted deviation of the torque, relative, and the
    least copper loss with it in W, NaN where there is none. ``confirmations`` are the quadratic
    programmes behind ``limited`` and the front, solved again by OSQP; salient machines have none,
    since their programmes are not quadratic: of those ``floor`` is a loss in W that no currents of
    constant torque undercut (NaN where a ripple is permitted), and ``iterations`` those of IPOPT
    for ``limited``, 0 where it is proven to be the global optimum.
    ``without_phase`` is what constant torque costs with a phase open, None where all are there, for
    salient machines, and where two phases make none.
    """

    machine: AnyPhaseMachine
    torque: float
    omega_m: float
    limits: WaveformLimits
    rules: tuple[RuleCurrents, ...]
    binding: tuple[str, ...]
    impossible: tuple[tuple[CurrentRule, str], ...]
    front: tuple[tuple[float, float], ...]
    confirmations: tuple[Confirmation, ...] = ()
    floor: float = math.nan
    iterations: int = 0
    without_phase: OpenPhasePrice | None = None


@dataclass(frozen=True, slots=True)
class _Limited:
    """The currents within all limits, and what is known of them."""

    currents: FloatArray
    binding: tuple[str, ...]
    front: FloatArray
    confirmations: tuple[Confirmation, ...] = ()
    floor: float = math.nan
    iterations: int = 0


def require_phases(design: Design) -> AnyPhaseMachine:
    """The machine in phase quantities.

    Raises:
        InputError: The design's machine has a sinusoidal back-EMF.
    """
    if design.phase_machine is None:
        raise InputError(
            "this design's machine has a sinusoidal back-EMF; phase currents are shaped for model: "
            "waveform, see 'dqforge machines paper002-phase-waveforms'"
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
    """Torque in N m and mechanical speed in rad/s: as set, or that of dq at the current limit,
    and the base speed.
    """
    torque, omega_m = settings.torque, settings.omega_m
    if torque is None:
        is_salient = isinstance(design.phase_machine, SalientPhaseMachine)
        torque = (
            _mtpa(design).largest_torque()
            if is_salient
            else design.machine.torque_per_ampere * design.i_max
        )
    if omega_m is None:
        i_d, i_q = (np.array([current]) for current in _dq_currents(design, torque))
        volts = design.inverter.v_dc * sine_share(design.inverter.topology)
        omega_m = float(limit_speed(design.machine, i_d, i_q, volts)[0])
    return torque, omega_m


def _mtpa(design: Design) -> CurrentChoice:
    return CurrentChoice(design.machine, "mtpa", design.i_max)


def _dq_currents(design: Design, torque: float) -> tuple[float, float]:
    """Least-loss currents (i_d, i_q) in A of the machine in dq coordinates."""
    if not isinstance(design.phase_machine, SalientPhaseMachine):
        return 0.0, torque / design.machine.torque_per_ampere
    i_d, i_q = _mtpa(design).currents(np.array([abs(torque)]))
    return float(i_d[0]), math.copysign(float(i_q[0]), torque)


@on_design("waveform")
def compare_waveforms(
    design: Design, settings: WaveformSettings | None = None
) -> WaveformComparison:
    """Phase currents by dq, dqx, dqy, and within all limits, at one operating point.

    Raises:
        InputError: The machine has a sinusoidal back-EMF.
        NoSolutionError: No currents keep the limits; says what would have to give.
    """
    machine = require_phases(design)
    settings = design.waveform if settings is None else settings
    torque, omega_m = operating_point(design, settings)
    limits = limits_of(design, settings, torque)
    rules, impossible = [], []
    for rule in get_args(CurrentRule):
        try:
            currents = _by_rule(design, machine, rule, torque)
        except NoSolutionError as error:
            impossible.append((rule, error.message))
            continue
        blocked = what_diodes_block(machine, currents, omega_m, limits.topology)
        if blocked:
            impossible.append((rule, blocked))
            continue
        rules.append(_judged(machine, rule, currents, omega_m, limits))
    if isinstance(machine, SalientPhaseMachine):
        found = _salient(machine, torque, omega_m, limits)
    else:
        found = _quadratic(machine, torque, omega_m, limits)
    rules.append(_judged(machine, "limited", found.currents, omega_m, limits))
    front = tuple(zip(FRONT_RIPPLES, found.front.tolist(), strict=True))
    return WaveformComparison(
        machine=machine,
        torque=torque,
        omega_m=omega_m,
        limits=limits,
        rules=tuple(rules),
        binding=found.binding,
        impossible=tuple(impossible),
        front=front,
        confirmations=found.confirmations,
        floor=found.floor,
        iterations=found.iterations,
        without_phase=_without_phase(machine, torque, limits),
    )


def _without_phase(
    machine: AnyPhaseMachine, torque: float, limits: WaveformLimits
) -> OpenPhasePrice | None:
    if limits.open_phase is None or not isinstance(machine, PhaseMachine) or torque == 0.0:
        return None
    return open_phase_price(machine, limits.topology, limits.open_phase, torque)


def _by_rule(
    design: Design, machine: AnyPhaseMachine, rule: CurrentRule, torque: float
) -> FloatArray:
    """Phase currents in A, shape (3, N), of a rule that knows no limit.

    A salient machine's dq currents are those of MTPA, its dqx and dqy the least loss angle by angle
    without and with zero sequence, as those of others.
    """
    if isinstance(machine, PhaseMachine):
        return np.asarray(torque * unit_currents(machine, rule))
    if rule != "dq":
        topology: Topology = "three-wire" if rule == "dqx" else "six-leg"
        return np.asarray(pointwise_currents(machine, np.array([torque]), topology)[0])
    return dq_waveform(*_dq_currents(design, torque), machine.angles, machine.turns)


def _quadratic(
    machine: PhaseMachine, torque: float, omega_m: float, limits: WaveformLimits
) -> _Limited:
    """Quadratic programmes, each solved a second time by OSQP."""
    found = solve_waveforms(machine, torque, omega_m, limits)
    require_solution(machine, found, limits)
    binding = tuple(name for name, binds in zip(LIMITS, found.binding[0], strict=True) if binds)
    confirmed, losses = [*confirm_waveforms(machine, found, limits)], []
    for within in _front_limits(torque, limits):
        point: WaveformSolutions | None = None
        # Where some angle makes no torque, there is no programme for constant torque.
        with contextlib.suppress(NoSolutionError):
            point = solve_waveforms(machine, torque, omega_m, within)
        losses.append(math.nan if point is None else float(point.copper[0]))
        if point is not None:
            confirmed += confirm_waveforms(machine, point, within)
    return _Limited(found.currents[0], binding, np.array(losses), tuple(confirmed))


def _salient(
    machine: SalientPhaseMachine, torque: float, omega_m: float, limits: WaveformLimits
) -> _Limited:
    """The optimum angle by angle where it keeps all limits, else nonlinear programmes."""
    found = solve_salient(machine, torque, omega_m, limits)
    losses = []
    for within in _front_limits(torque, limits):
        point: SalientWaveforms | None = None
        with contextlib.suppress(NoSolutionError):
            point = solve_salient(machine, torque, omega_m, within)
        losses.append(math.nan if point is None else point.copper)
    return _Limited(
        found.currents,
        found.binding,
        np.array(losses),
        floor=found.floor,
        iterations=found.iterations,
    )


def _front_limits(torque: float, limits: WaveformLimits) -> list[WaveformLimits]:
    """The limits with each of `FRONT_RIPPLES`."""
    return [replace(limits, ripple=ripple * abs(torque)) for ripple in FRONT_RIPPLES]


def _judged(
    machine: AnyPhaseMachine,
    rule: Rule,
    currents: FloatArray,
    omega_m: float,
    limits: WaveformLimits,
) -> RuleCurrents:
    """Currents with their figures and what they break."""
    found = figures(machine, currents[np.newaxis], np.array([omega_m]), limits.topology)
    obstacles = []
    fed = TOPOLOGIES[limits.topology]
    if not (fed.neutral or fed.diodes) and found.neutral_rms[0] > _EXACT * found.rms[0]:
        obstacles.append("needs the neutral")
    if found.peak[0] > limits.i_max * (1.0 + _EXACT):
        obstacles.append("current limit")
    if found.bus[0] > limits.v_dc * (1.0 + _EXACT):
        obstacles.append("dc link")
    if limits.open_phase is not None and np.any(currents["abc".index(limits.open_phase)]):
        obstacles.append("open phase")
    lines, orders = spectrum(currents, machine.turns)
    return RuleCurrents(
        rule, currents, machine.torque(currents), found, tuple(obstacles), lines, orders
    )


def what_diodes_block(
    machine: AnyPhaseMachine, currents: FloatArray, omega_m: float, topology: Topology
) -> str:
    """Why phase currents in A, shape (3, N), do not flow where the neutral hangs on diodes; empty
    where they do, or where it does not.

    A current out of the machine (positive) holds the neutral at the upper rail, so that no phase
    voltage is positive while it flows, and the other way round.
    """
    if not TOPOLOGIES[topology].diodes:
        return ""
    # Voltages are those in the middle between two angles.
    neutral = np.sum(between(currents)[0], axis=0)
    wanted = np.abs(neutral) > _EXACT * np.max(np.abs(currents))
    voltages = machine.voltage(currents, machine.pole_pairs * omega_m)
    passes = np.all(voltages * np.sign(neutral) <= 0.0, axis=0)
    if not np.any(wanted & ~passes):
        return ""
    share = 100.0 * np.count_nonzero(wanted & passes) / np.count_nonzero(wanted)
    return (
        "the diodes of the neutral pass a current only while all phase voltages oppose it, which "
        f"they do at {share:.0f} % of the angles where these currents need it; use dqx"
    )


def with_point(
    settings: WaveformSettings,
    torque: float | None,
    omega_m: float | None,
    ripple: float | None,
    phase: str | None,
) -> WaveformSettings:
    """Settings in which what is given replaces what was set.

    Raises:
        InputError: The open phase is none of a, b and c, or the ripple is no share.
    """
    if phase is not None and phase not in ("a", "b", "c"):
        raise InputError(f"--open-phase: expected a, b or c, got '{phase}'")
    if ripple is not None and not 0.0 <= ripple < 1.0:
        raise InputError(
            f"--ripple: expected a share below 100 % such as '5 %', got {100.0 * ripple:g} %"
        )
    given = {"torque": torque, "omega_m": omega_m, "ripple": ripple, "open_phase": phase}
    changes = {key: value for key, value in given.items() if value is not None}
    return replace(settings, **changes)  # type: ignore[arg-type]
