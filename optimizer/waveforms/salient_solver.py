"""Least-loss phase currents of salient machines at one operating point,
by a nonlinear programme (CasADi and IPOPT).

With inductances that vary with the angle the torque is quadratic in the currents, so that the
programme is not convex. Where the currents that are best angle by angle keep every limit, they are
the global optimum and nothing is searched; else they are where IPOPT starts, what it finds is a
local optimum, and their loss bounds how much better any could be.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import Topology
from dqforge.machines.phase_machines.phase_machine import (
    MIDDLE,
    OFFSETS,
    SLOPE,
    between,
    shift_of,
)
from dqforge.machines.phase_machines.salient_phase_machine import SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.waveforms.constraint_rows import LIMITS, WaveformLimits
from dqforge.optimizer.waveforms.phase_currents import unit_currents
from dqforge.optimizer.waveforms.pointwise_currents import pointwise_currents

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
        f"{torque:.4g} N m at {omega_m * 30.0 / np.pi:.4g} rpm within {limits.v_dc:.4g} V "
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
            f"no phase currents found for {where}: IPOPT says {statistics['return_status']}"
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
