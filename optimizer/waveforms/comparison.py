"""Phase currents of a design's machine by every rule, side by side at one operating point."""

from __future__ import annotations

import contextlib
import importlib
import math
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.design.settings import WaveformSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import OpenPhase, Topology
from dqforge.machines.phase_machines.phase_machine import (
    MIDDLE,
    OFFSETS,
    SLOPE,
    AnyPhaseMachine,
    PhaseMachine,
    SalientPhaseMachine,
    between,
    shift_of,
)
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES, sine_share
from dqforge.machines.transforms import in_rpm
from dqforge.optimizer.operating_points.characteristics import limit_speed
from dqforge.optimizer.operating_points.current_choice import CurrentChoice
from dqforge.optimizer.waveforms.constraint_rows import (
    LIMITS,
    CurrentRule,
    WaveformFigures,
    WaveformLimits,
    dq_waveform,
    figures,
    pointwise_currents,
    spectrum,
    unit_currents,
)
from dqforge.optimizer.waveforms.solver import (
    Confirmation,
    WaveformSolutions,
    confirm_waveforms,
    require_solution,
    solve_waveforms,
)

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


# Least-loss phase currents of salient machines at one operating point,
# by a nonlinear programme (CasADi and IPOPT).
#
# With inductances that vary with the angle the torque is quadratic in the currents, so that the
# programme is not convex. Where the currents that are best angle by angle keep every limit, they
# are the global optimum and nothing is searched; else they are where IPOPT starts, what it finds is
# a local optimum, and their loss bounds how much better any could be.

_REACH = max(OFFSETS)


_TOLERANCE = 1e-10


_MOST_ITERATIONS = 500


_BINDING = 1e-6


_OFFERED = tuple(name for name, rule in TOPOLOGIES.items() if not rule.diodes)


@dataclass(frozen=True, slots=True, eq=False)
class SalientWaveforms:
    """Phase currents at one operating point.

    ``currents`` in A and ``voltages`` in V, shape (3, N); ``torque`` in N m, shape (N,); ``copper``
    in W. ``violation`` is the largest violation of a constraint of the programme, relative to
    torque, dc link or current limit. ``binding`` names the limits that hold the currents. ``floor``
    in W is a loss below which no currents of constant torque exist: it equals ``copper`` where the
    optimum is proven to be global; NaN where a ripple is permitted. ``iterations`` of IPOPT, 0
    where nothing had to be searched.
    """

    currents: FloatArray
    voltages: FloatArray
    torque: FloatArray
    copper: float
    violation: float
    iterations: int
    binding: tuple[str, ...]
    floor: float


class _Rows:
    """Constraints lower <= expression <= upper, collected kind by kind; ``None`` are equations."""

    def __init__(self, casadi: Any) -> None:
        self._casadi = casadi
        self._expressions: list[Any] = []
        self._bounds: list[FloatArray] = []
        self.kinds: list[str | None] = []

    def add(self, kind: str | None, expression: Any, lower: float, upper: float) -> None:
        """Bound every entry of a matrix."""
        flat = self._casadi.vec(expression)
        self.kinds += [kind] * flat.numel()
        self._expressions.append(flat)
        self._bounds.append(np.tile([lower, upper], (flat.numel(), 1)))

    @property
    def expression(self) -> Any:
        return self._casadi.vertcat(*self._expressions)

    @property
    def bounds(self) -> FloatArray:
        """Lower and upper bounds, shape (m, 2)."""
        return np.concatenate(self._bounds)


def solve_salient(
    machine: SalientPhaseMachine, torque: float, omega_m: float, limits: WaveformLimits
) -> SalientWaveforms:
    """Phase currents of least copper loss for a torque in N m at a mechanical speed in rad/s.

    Raises:
        InputError: A number is not finite, the topology is ``diode-neutral``, or CasADi is not
            installed.
        NoSolutionError: No currents were found within the limits.
    """
    if not np.all(np.isfinite([torque, omega_m])):
        raise InputError("torque and speed must be finite; got nan or inf")
    if limits.topology not in _OFFERED:
        raise InputError(
            f"salient machines: {limits.topology} is not offered; use one of {', '.join(_OFFERED)}"
        )
    casadi = _casadi()
    part, shift = _part_and_shift(machine, limits)
    currents = casadi.SX.sym("i", 3, part)
    rows = _constraints(casadi, machine, currents * limits.i_max, torque, omega_m, limits, shift)
    least, most = _current_bounds(limits, part)
    best, start = _start(machine, torque, limits)
    floor = np.nan if best is None or limits.ripple > 0.0 else float(machine.copper_loss(best))
    first, iterations = start[:, :part] / limits.i_max, 0
    values = casadi.Function("rows", [casadi.vec(currents)], [rows.expression])
    if not np.isfinite(floor) or _over(rows, values, first, (least, most)) > _TOLERANCE:
        x = np.clip(first, least, most)
        first, iterations = _search(
            casadi, currents, rows, x, (least, most), _where(torque, omega_m, limits)
        )
    waveform = _whole(limits.i_max * first, shift, machine.phases.angles // part)
    return SalientWaveforms(
        currents=waveform,
        voltages=machine.voltage(waveform, machine.phases.pole_pairs * omega_m),
        torque=machine.torque(waveform),
        copper=float(machine.copper_loss(waveform)),
        violation=max(_over(rows, values, first, (least, most)), 0.0),
        iterations=iterations,
        binding=_binding(rows, values, first, most),
        floor=floor,
    )


def _where(torque: float, omega_m: float, limits: WaveformLimits) -> str:
    """The operating point and its limits, as a part of a sentence."""
    return (
        f"{torque:.4g} N m at {in_rpm(omega_m):.4g} rpm within {limits.v_dc:.4g} V "
        f"({limits.topology}) and {limits.i_max:.4g} A"
    )


def _search(
    casadi: Any,
    currents: Any,
    rows: _Rows,
    start: FloatArray,
    box: tuple[FloatArray, FloatArray],
    where: str,
) -> tuple[FloatArray, int]:
    """Currents over the current limit, shape (3, part), and iterations of IPOPT."""
    programme = {
        "x": casadi.vec(currents),
        "f": casadi.sumsqr(currents) / start.shape[1],
        "g": rows.expression,
    }
    quiet = {"print_level": 0, "sb": "yes", "tol": _TOLERANCE, "constr_viol_tol": _TOLERANCE}
    exact = {"bound_relax_factor": 0.0, "max_iter": _MOST_ITERATIONS}
    solver = casadi.nlpsol(
        "waveform", "ipopt", programme, {"ipopt": quiet | exact, "print_time": False}
    )
    bounds = rows.bounds
    found = solver(
        x0=_flat(start), lbx=_flat(box[0]), ubx=_flat(box[1]), lbg=bounds[:, 0], ubg=bounds[:, 1]
    )
    statistics = solver.stats()
    if not statistics["success"]:
        raise NoSolutionError(
            f"no phase currents found for {where}: IPOPT returns {statistics['return_status']}"
        )
    return np.asarray(found["x"]).reshape(start.shape, order="F"), int(statistics["iter_count"])


def _over(rows: _Rows, values: Any, first: FloatArray, box: tuple[FloatArray, FloatArray]) -> float:
    """Largest excess over a bound; negative where all are kept with room."""
    value, bounds = np.asarray(values(_flat(first))).ravel(), rows.bounds
    beyond = np.maximum(value - bounds[:, 1], bounds[:, 0] - value)
    return float(max(np.max(beyond), np.max(first - box[1]), np.max(box[0] - first)))


def _binding(rows: _Rows, values: Any, first: FloatArray, most: FloatArray) -> tuple[str, ...]:
    """Kinds of limits of which some row is at its bound."""
    value, bounds = np.asarray(values(_flat(first))).ravel(), rows.bounds
    at_bound = np.maximum(value - bounds[:, 1], bounds[:, 0] - value) >= -_BINDING
    held = {kind for kind, at in zip(rows.kinds, at_bound, strict=True) if at}
    if np.any((np.abs(first) >= most - _BINDING) & (most > 0.0)):
        held.add("current")
    return tuple(kind for kind in LIMITS if kind in held)


def _casadi() -> Any:
    try:
        return importlib.import_module("casadi")
    except ImportError as error:
        raise InputError(
            "phase currents of salient machines need casadi; install it with: pip install casadi"
        ) from error


def _part_and_shift(machine: SalientPhaseMachine, limits: WaveformLimits) -> tuple[int, FloatArray]:
    """Number of angles that tell all, and how the phases behind them follow
    from those at the beginning.
    """
    symmetry = "none" if limits.open_phase is not None else machine.symmetry
    parts = {"sixth": 6, "third": 3, "none": 1}[symmetry]
    return machine.phases.angles // parts, shift_of(parts, machine.turns)


def _whole(first: FloatArray, shift: FloatArray, parts: int) -> FloatArray:
    """Waveform over all angles, shape (3, N), from its first part."""
    pieces = [first]
    for _ in range(parts - 1):
        pieces.append(shift @ pieces[-1])
    return np.concatenate(pieces, axis=1)


def _flat(waveform: FloatArray) -> FloatArray:
    """The phases of an angle side by side, as CasADi stacks columns."""
    return waveform.ravel(order="F")


def _current_bounds(limits: WaveformLimits, part: int) -> tuple[FloatArray, FloatArray]:
    """Bounds of the currents over the current limit, shapes (3, part)."""
    most = np.ones((3, part))
    if limits.open_phase is not None:
        most["abc".index(limits.open_phase)] = 0.0
    return -most, most


def _start(
    machine: SalientPhaseMachine, torque: float, limits: WaveformLimits
) -> tuple[FloatArray | None, FloatArray]:
    """Best currents in A of constant torque angle by angle, None without any,
    and those to start from; (3, N).
    """
    try:
        best = pointwise_currents(machine, np.array([torque]), limits.topology, limits.open_phase)[
            0
        ]
    except NoSolutionError:
        return None, torque * unit_currents(machine.phases, "dq")
    return best, best


def _between(casadi: Any, waveform: Any, shift: FloatArray, step: float) -> tuple[Any, Any]:
    """Value and slope of a part of a waveform, shape (3, part), half a step behind each angle,
    as the phase model's; ``step`` in rad.
    """
    part = waveform.shape[1]
    # What follows the part, and what comes before it, are its own ends in other phases.
    around = casadi.horzcat(
        shift.T @ waveform[:, part - _REACH :], waveform, shift @ waveform[:, :_REACH]
    )
    value, slope = 0, 0
    for offset, of_value, of_slope in zip(OFFSETS, MIDDLE, SLOPE, strict=True):
        moved = around[:, _REACH + offset : _REACH + offset + part]
        value += of_value * moved
        slope += of_slope / step * moved
    return value, slope


def _constraints(
    casadi: Any,
    machine: SalientPhaseMachine,
    currents: Any,
    torque: float,
    omega_m: float,
    limits: WaveformLimits,
    shift: FloatArray,
) -> _Rows:
    """What phase currents in A, shape (3, part), keep; every row of order one."""
    part, phases = currents.shape[1], machine.phases
    omega_e, slopes = phases.pole_pairs * omega_m, machine.slope
    linked = casadi.horzcat(*[machine.inductance[j] @ currents[:, j] for j in range(part)])
    reluctance = casadi.horzcat(
        *[casadi.bilin(slopes[j], currents[:, j], currents[:, j]) / 2.0 for j in range(part)]
    )
    flux = phases.flux[:, :part]
    made = phases.pole_pairs * (casadi.sum1(flux * currents) + reluctance)
    step = 2.0 * np.pi * phases.turns / phases.angles
    value, slope = _between(casadi, currents, shift, step)
    emf = between(phases.flux)[0][:, :part] + _between(casadi, linked, shift, step)[1]
    volts = phases.r_s * value + omega_e * emf
    rows = _Rows(casadi)
    _add_torque(
        rows,
        casadi,
        made,
        torque,
        limits.ripple,
        phases.pole_pairs * np.max(np.abs(flux)) * limits.i_max,
    )
    _add_bus(rows, casadi, volts / limits.v_dc, limits.topology)
    mirrored = phases.turns % 2 == 1 and 6 * part == phases.angles
    _add_neutral(rows, casadi, casadi.sum1(currents) / limits.i_max, limits, mirrored=mirrored)
    if limits.slew is not None:
        rows.add("slew", omega_e * slope / limits.slew, -1.0, 1.0)
    return rows


def _add_torque(
    rows: _Rows, casadi: Any, made: Any, torque: float, ripple: float, scale: float
) -> None:
    if ripple == 0.0:
        rows.add(None, (made - torque) / scale, 0.0, 0.0)
        return
    rows.add("ripple", (made - torque) / ripple, -1.0, 1.0)
    rows.add(None, (casadi.sum2(made) / made.numel() - torque) / scale, 0.0, 0.0)


def _add_bus(rows: _Rows, casadi: Any, volts: Any, topology: Topology) -> None:
    single, between = TOPOLOGIES[topology].phase, TOPOLOGIES[topology].between
    if single is not None:
        rows.add("voltage", volts, -single, single)
    if between is not None:
        pairs = casadi.vertcat(
            volts[0, :] - volts[1, :], volts[1, :] - volts[2, :], volts[2, :] - volts[0, :]
        )
        rows.add("voltage", pairs, -between, between)


def _add_neutral(
    rows: _Rows, casadi: Any, neutral: Any, limits: WaveformLimits, *, mirrored: bool
) -> None:
    if not TOPOLOGIES[limits.topology].neutral:
        rows.add(None, neutral, 0.0, 0.0)
        return
    # With mirrored half waves the neutral current has no mean anyway,
    # though it has one over the sixth.
    if TOPOLOGIES[limits.topology].midpoint and not mirrored:
        rows.add(None, casadi.sum2(neutral) / neutral.numel(), 0.0, 0.0)
    if limits.neutral is not None:
        most = limits.neutral / limits.i_max
        rows.add("neutral", neutral, -most, most)


# What constant torque costs once a phase is open, against all three phases.
#
# With a neutral the two phases that are left make constant torque in closed form, i = T f / (p
# |f|^2) with the back-EMF of the open phase set to zero; without one they carry one current, and
# the torque vanishes twice a period.

_VANISHING = 1e-6


@dataclass(frozen=True, slots=True)
class OpenPhasePrice:
    """Figures of constant torque with two phases over those with three by dqy.

    Args:
        phase: The one that is open.
        copper, peak: Copper loss and largest phase current, times those of three phases.
        neutral_rms, neutral_peak: Of the neutral current in A.
        neutral: Peak of the neutral over that of a phase while all three are there: what the
            neutral's leg must carry.
        torque_at_peak, torque_at_copper: Share of the torque that is left with the same phase peak,
            and with the same copper loss.
    """

    phase: OpenPhase
    copper: float
    peak: float
    neutral_rms: float
    neutral_peak: float
    neutral: float
    torque_at_peak: float
    torque_at_copper: float


def open_phase_price(
    machine: PhaseMachine, topology: Topology, phase: OpenPhase, torque: float
) -> OpenPhasePrice | None:
    """The price, None where constant torque cannot be made: without a neutral, or where the two
    phases that are left make none at some angle.

    Args:
        machine: The machine.
        topology: How it is fed.
        phase: The phase that carries no current.
        torque: In N m.
    """
    if not TOPOLOGIES[topology].neutral:
        return None
    left = machine.flux.copy()
    left["abc".index(phase)] = 0.0
    squares = [np.sum(flux**2, axis=0) for flux in (machine.flux, left)]
    if min(float(np.min(square)) for square in squares) <= _VANISHING**2 * float(
        np.max(squares[0])
    ):
        return None
    healthy, faulty = (
        torque * flux / (machine.pole_pairs * square)
        for flux, square in zip((machine.flux, left), squares, strict=True)
    )
    copper = float(machine.copper_loss(faulty) / machine.copper_loss(healthy))
    whole_peak = float(np.max(np.abs(healthy)))
    peak = float(np.max(np.abs(faulty))) / whole_peak
    through = np.sum(faulty, axis=0)
    neutral_peak = float(np.max(np.abs(through)))
    return OpenPhasePrice(
        phase=phase,
        copper=copper,
        peak=peak,
        neutral_rms=float(np.sqrt(np.mean(through**2))),
        neutral_peak=neutral_peak,
        neutral=neutral_peak / whole_peak,
        torque_at_peak=1.0 / peak,
        torque_at_copper=1.0 / math.sqrt(copper),
    )
