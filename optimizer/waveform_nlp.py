"""Least-loss phase currents of salient machines at one operating point, by a nonlinear programme (CasADi and IPOPT).

With inductances that vary with the angle the torque is quadratic in the currents, so that the programme is not convex:
what is found is a local optimum, reached from the currents of the machine without saliency.
"""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any

import numpy as np

from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.inverter import Topology
from dqforge.machines.phase_machine import MIDDLE, OFFSETS, SHIFT_SIXTH, SHIFT_THIRD, SLOPE, PhaseMachine, between
from dqforge.machines.salient_phase_machine import SalientPhaseMachine
from dqforge.machines.synchronous import FloatArray
from dqforge.optimizer.phase_currents import unit_currents
from dqforge.optimizer.waveform_problem import WaveformLimits

_REACH = max(OFFSETS)
_TOLERANCE = 1e-10
_MOST_ITERATIONS = 500
# Share of v_dc that each phase voltage, and each difference between two, may reach.
_BUS: dict[Topology, tuple[float | None, float | None]] = {
    "three-wire": (None, 1.0),
    "four-leg": (1.0, 1.0),
    "split-capacitor": (0.5, None),
    "six-leg": (1.0, None),
}


@dataclass(frozen=True, slots=True, eq=False)
class SalientWaveforms:
    """Phase currents at one operating point.

    ``currents`` in A and ``voltages`` in V, shape (3, N); ``torque`` in N m, shape (N,); ``copper`` in W. ``violation``
    is the largest violation of a constraint of the programme, relative to torque, dc link or current limit.
    """

    currents: FloatArray
    voltages: FloatArray
    torque: FloatArray
    copper: float
    violation: float
    iterations: int


class _Rows:
    """Constraints lower <= expression <= upper, collected kind by kind."""

    def __init__(self, casadi: Any) -> None:
        self._casadi = casadi
        self._expressions: list[Any] = []
        self._bounds: list[FloatArray] = []

    def add(self, expression: Any, lower: float, upper: float) -> None:
        """Bound every entry of a matrix."""
        flat = self._casadi.vec(expression)
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

    Raises
    ------
    InputError
        A number is not finite, the topology is ``diode-neutral``, or CasADi is not installed.
    NoSolutionError
        No currents were found within the limits.
    """
    if not np.all(np.isfinite([torque, omega_m])):
        raise InputError("torque and speed must be finite; got nan or inf")
    if limits.topology not in _BUS:
        raise InputError(f"salient machines: {limits.topology} is not offered; use one of {', '.join(_BUS)}")
    casadi = _casadi()
    part, shift = _part_and_shift(machine, limits)
    currents = casadi.SX.sym("i", 3, part)
    rows = _constraints(casadi, machine, currents * limits.i_max, torque, omega_m, limits, shift)
    programme = {"x": casadi.vec(currents), "f": casadi.sumsqr(currents) / part, "g": rows.expression}
    quiet = {"print_level": 0, "sb": "yes", "tol": _TOLERANCE, "constr_viol_tol": _TOLERANCE}
    exact = {"bound_relax_factor": 0.0, "max_iter": _MOST_ITERATIONS}
    solver = casadi.nlpsol("waveform", "ipopt", programme, {"ipopt": quiet | exact, "print_time": False})
    least, most = _current_bounds(limits, part)
    bounds = rows.bounds
    start = np.clip(_start(machine.phases, torque, limits)[:, :part] / limits.i_max, least, most)
    found = solver(x0=_flat(start), lbx=_flat(least), ubx=_flat(most), lbg=bounds[:, 0], ubg=bounds[:, 1])
    statistics = solver.stats()
    if not statistics["success"]:
        raise NoSolutionError(
            f"no phase currents found for {torque:.4g} N m at {omega_m * 30.0 / np.pi:.4g} rpm within"
            f" {limits.v_dc:.4g} V ({limits.topology}) and {limits.i_max:.4g} A:"
            f" IPOPT says {statistics['return_status']}"
        )
    value = np.asarray(found["g"]).ravel()
    over = np.maximum(value - bounds[:, 1], bounds[:, 0] - value)
    first = limits.i_max * np.asarray(found["x"]).reshape((3, part), order="F")
    waveform = _whole(first, shift, machine.phases.angles // part)
    return SalientWaveforms(
        currents=waveform,
        voltages=machine.voltage(waveform, machine.phases.pole_pairs * omega_m),
        torque=machine.torque(waveform),
        copper=float(machine.phases.copper_loss(waveform)),
        violation=float(max(np.max(over), 0.0)),
        iterations=int(statistics["iter_count"]),
    )


def _casadi() -> Any:
    try:
        return importlib.import_module("casadi")
    except ImportError as error:
        raise InputError(
            "phase currents of salient machines need CasADi; install it with: pip install dqforge[nlp]"
        ) from error


def _part_and_shift(machine: SalientPhaseMachine, limits: WaveformLimits) -> tuple[int, FloatArray]:
    """Number of angles that tell all, and how the phases behind them follow from those at the beginning."""
    symmetry = "none" if limits.open_phase is not None else machine.symmetry
    parts, shift = {"sixth": (6, SHIFT_SIXTH), "third": (3, SHIFT_THIRD), "none": (1, np.eye(3))}[symmetry]
    return machine.phases.angles // parts, shift


def _whole(first: FloatArray, shift: FloatArray, parts: int) -> FloatArray:
    """Waveform of the whole period, shape (3, N), from its first part."""
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


def _start(phases: PhaseMachine, torque: float, limits: WaveformLimits) -> FloatArray:
    """Currents in A to start from, shape (3, N): those of constant torque, or dq currents where there are none."""
    try:
        return torque * unit_currents(phases, "dqx" if limits.topology == "three-wire" else "dqy")
    except NoSolutionError:
        return torque * unit_currents(phases, "dq")


def _between(casadi: Any, waveform: Any, shift: FloatArray, angles: int) -> tuple[Any, Any]:
    """Value and slope of a part of a waveform, shape (3, part), half a step behind each angle, as the phase model's."""
    part = waveform.shape[1]
    # What follows the part, and what comes before it, are its own ends in other phases.
    around = casadi.horzcat(shift.T @ waveform[:, part - _REACH :], waveform, shift @ waveform[:, :_REACH])
    value, slope = 0, 0
    for offset, of_value, of_slope in zip(OFFSETS, MIDDLE, SLOPE, strict=True):
        moved = around[:, _REACH + offset : _REACH + offset + part]
        value += of_value * moved
        slope += of_slope * angles / (2.0 * np.pi) * moved
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
    reluctance = casadi.horzcat(*[casadi.bilin(slopes[j], currents[:, j], currents[:, j]) / 2.0 for j in range(part)])
    flux = phases.flux[:, :part]
    made = phases.pole_pairs * (casadi.sum1(flux * currents) + reluctance)
    value, slope = _between(casadi, currents, shift, phases.angles)
    emf = between(phases.flux)[0][:, :part] + _between(casadi, linked, shift, phases.angles)[1]
    volts = phases.r_s * value + omega_e * emf
    rows = _Rows(casadi)
    _add_torque(rows, casadi, made, torque, limits.ripple, phases.pole_pairs * np.max(np.abs(flux)) * limits.i_max)
    _add_bus(rows, casadi, volts / limits.v_dc, limits.topology)
    _add_neutral(rows, casadi, casadi.sum1(currents) / limits.i_max, limits, phases.angles // part)
    if limits.slew is not None:
        rows.add(omega_e * slope / limits.slew, -1.0, 1.0)
    return rows


def _add_torque(rows: _Rows, casadi: Any, made: Any, torque: float, ripple: float, scale: float) -> None:
    if ripple == 0.0:
        rows.add((made - torque) / scale, 0.0, 0.0)
        return
    rows.add((made - torque) / ripple, -1.0, 1.0)
    rows.add((casadi.sum2(made) / made.numel() - torque) / scale, 0.0, 0.0)


def _add_bus(rows: _Rows, casadi: Any, volts: Any, topology: Topology) -> None:
    single, between = _BUS[topology]
    if single is not None:
        rows.add(volts, -single, single)
    if between is not None:
        pairs = casadi.vertcat(volts[0, :] - volts[1, :], volts[1, :] - volts[2, :], volts[2, :] - volts[0, :])
        rows.add(pairs, -between, between)


def _add_neutral(rows: _Rows, casadi: Any, neutral: Any, limits: WaveformLimits, parts: int) -> None:
    if limits.topology == "three-wire":
        rows.add(neutral, 0.0, 0.0)
        return
    # With mirrored half waves the neutral current has no mean anyway, though it has one over the sixth.
    if limits.topology == "split-capacitor" and parts < 6:
        rows.add(casadi.sum2(neutral) / neutral.numel(), 0.0, 0.0)
    if limits.neutral is not None:
        most = limits.neutral / limits.i_max
        rows.add(neutral, -most, most)
