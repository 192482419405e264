"""Tables of the frames dqx and dqy with linear interpolation: sizes, errors, and the smallest
that holds.
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.phase_machines.frame_transforms import (
    CLARKE,
    amplitude_factor,
    frame_model,
    frame_rates,
    resampled,
    spectral_derivative,
    to_frame,
)
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, SalientPhaseMachine, grid
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import tables_obstacle
from dqforge.machines.transforms import POWER_INVARIANT, Reals
from dqforge.optimizer.curves.single_precision import (
    CONTRACTED,
    SINGLE,
    SingleArray,
    between,
    interval,
    rest,
    within_turn,
)
from dqforge.optimizer.steps.step_arithmetic import Arithmetic, Member

SIZES = (48, 96, 192, 384, 768, 1536)  # Intervals of an electrical period.
_FLOAT_BYTES = 4
_LEAST_SCALE = 1e-9


class Frames(NamedTuple):
    """The frames at an angle."""

    a_x: Annotated[
        Reals,
        Member(
            "sqrt(3/2) over the length of the alpha-beta vector of the shape: dqx is divided by it"
        ),
    ]
    a_y: Annotated[
        Reals,
        Member("sqrt(3/2) over the length of its alpha-beta-0 vector: dqy is divided by it"),
    ]
    theta_x: Annotated[Reals, Member("angle from dq to dqx, rad")]
    theta_y: Annotated[Reals, Member("angle from dqx to dqy, rad")]
    turn_x: Annotated[
        Reals,
        Member("1 + d theta_x / d theta: speed of dqx over the electrical speed"),
    ]
    rate_y: Annotated[Reals, Member("d theta_y / d theta")]
    growth_x: Annotated[Reals, Member("(d a_x / d theta) / a_x, 1/rad")]
    growth_y: Annotated[Reals, Member("(d a_y / d theta) / a_y, 1/rad")]
    emf: Annotated[Reals, Member("back-EMF of the q axis of dqy over the electrical speed, Wb")]
    c_dd: Annotated[Reals, Member("coupling of the d axis with the current of the d axis, H")]
    c_dq: Annotated[Reals, Member("coupling of the d axis with the current of the q axis, H")]
    c_d0: Annotated[Reals, Member("coupling of the d axis with the current of the 0 axis, H")]
    c_qd: Annotated[Reals, Member("coupling of the q axis with the current of the d axis, H")]
    c_qq: Annotated[Reals, Member("coupling of the q axis with the current of the q axis, H")]
    c_q0: Annotated[Reals, Member("coupling of the q axis with the current of the 0 axis, H")]
    c_0d: Annotated[Reals, Member("coupling of the 0 axis with the current of the d axis, H")]
    c_0q: Annotated[Reals, Member("coupling of the 0 axis with the current of the q axis, H")]
    c_00: Annotated[Reals, Member("coupling of the 0 axis with the current of the 0 axis, H")]


class DqyVoltages(NamedTuple):
    """Voltages of dqy, divided by a_y, in V."""

    d: Reals
    q: Reals
    zero: Reals


def decoupling(
    o: Arithmetic,  # noqa: ARG001
    frames: Frames,
    omega_e: Reals,
    i_d: Reals,
    i_q: Reals,
    i_0: Reals,
) -> DqyVoltages:
    """Voltages of dqy that the turning frame and the back-EMF make, divided by a_y, in V:
    omega_e (C i + e). omega_e: electrical speed in rad/s; i_d, i_q, i_0: currents of dqy, divided
    by a_y, in A.
    """
    at = frames
    d = ((at.c_dd * i_d) + (at.c_dq * i_q)) + (at.c_d0 * i_0)
    q = ((at.c_qd * i_d) + (at.c_qq * i_q)) + (at.c_q0 * i_0)
    zero = ((at.c_0d * i_d) + (at.c_0q * i_q)) + (at.c_00 * i_0)
    return DqyVoltages(omega_e * d, omega_e * (q + at.emf), omega_e * zero)


@dataclass(frozen=True, slots=True, eq=False)
class FrameTable:
    """Values between which straight lines are drawn.

    ``entries`` are those of `COLUMNS`, shape (N + 1, 18), at even angles over one ``parts``-th of
    the waveform, of which the last row repeats the first; ``parts`` is 3 for equal phases, whose
    frames repeat after each third, else 1.
    """

    entries: SingleArray
    parts: int

    @property
    def size(self) -> int:
        """Number N of intervals."""
        return int(self.entries.shape[0]) - 1

    @property
    def flash(self) -> int:
        """Bytes of constants."""
        return _FLOAT_BYTES * int(self.entries.size)

    def step(self, o: Arithmetic, turn: Reals, rows: Any) -> Frames:
        """The frames by linear interpolation.

        Args:
            o: The arithmetic.
            turn: From 0 to below 1, shape (M,); others, and NaN, count as 0.
            rows: What stands for ``entries``.
        """
        x = within_turn(o, turn)
        if self.parts == 3:
            thirds = o.let("thirds", x * 3.0)
            left = o.let("left", o.choose(thirds >= 2.0, thirds - 2.0, thirds))
            x = o.choose(left >= 1.0, left - 1.0, left)
        k, place = interval(o, x, self.size)
        f = rest(o, k, place)
        columns = range(len(Frames._fields))
        return Frames(*(between(o, f, o.at(rows, k, n), o.at(rows, k + 1, n)) for n in columns))

    def values(self, turn: SingleArray, o: Arithmetic = SINGLE) -> SingleArray:
        """What the emitted C reads, shape (18, M), at any turns, shape (M,)."""
        with np.errstate(invalid="ignore"):
            return np.stack(self.step(o, turn, self.entries))


@dataclass(frozen=True, slots=True)
class FrameErrors:
    """Largest errors over a dense set of angles, with and without fused multiply-add.

    ``torque_x`` and ``torque_y`` relative, of the torque that currents constant in dqx and dqy
    make; ``rates`` of 1 + theta_x', theta_y' and a'/a in 1/rad; ``coupling`` of the coupling
    inductances over the largest of them, and ``emf`` of the back-EMF over its largest value.
    """

    torque_x: float
    torque_y: float
    rates: float
    coupling: float
    emf: float

    @property
    def torque(self) -> float:
        """The larger one of both frames, by which the size is chosen."""
        return max(self.torque_x, self.torque_y)


@dataclass(frozen=True, slots=True)
class FrameCandidate:
    """A table with its errors."""

    table: FrameTable
    errors: FrameErrors


@dataclass(frozen=True, slots=True)
class FrameTables:
    """The table that is emitted, and the larger-stepped ones that do not hold.

    ``scale`` is phi_m in Wb, the largest back-EMF of a phase over the electrical speed; ``turns``
    the electrical periods that the waveform spans; ``tolerance`` the permitted torque error.
    """

    chosen: FrameCandidate
    coarser: tuple[FrameCandidate, ...]
    scale: float
    turns: int
    pole_pairs: int
    tolerance: float


def table_of(exact: ExactFrames, size: int, parts: int) -> FrameTable:
    """Table of the exact frames, with ``size`` intervals of an electrical period."""
    places = exact.columns[:, :: DENSE // size]
    part = places.shape[1] // parts
    scale = np.max(np.abs(exact.columns), axis=1, keepdims=True)
    places = np.where(np.abs(places) > _LEAST_SCALE * scale, places, 0.0)
    entries = np.concatenate([places[:, :part], places[:, :1]], axis=1)
    return FrameTable(np.ascontiguousarray(entries.T.astype(np.float32)), parts)


def errors_of(exact: ExactFrames, table: FrameTable, turns: int) -> FrameErrors:
    """Errors of a table against the exact frames at the dense angles."""
    count = exact.columns.shape[1]
    turn, theta = (np.arange(count) / count).astype(np.float32), grid(count, turns)
    worst = np.zeros(5)
    for o in (SINGLE, CONTRACTED):
        found = table.values(turn, o).astype(np.float64)
        away = dict(zip(COLUMNS, np.max(np.abs(found - exact.columns), axis=1), strict=True))
        size = dict(zip(COLUMNS, np.max(np.abs(exact.columns), axis=1), strict=True))
        worst = np.maximum(
            worst,
            [
                *torque_errors(exact.shape, theta, found[: len(ANGLES)]),
                max(away[name] for name in RATES),
                max(away[name] for name in COUPLING) / max(size[name] for name in COUPLING),
                away["emf"] / size["emf"],
            ],
        )
    return FrameErrors(*(float(value) for value in worst))


def fit_frames(machine: PhaseMachine, tolerance: float) -> FrameTables:
    """The smallest table whose torque errs by at most ``tolerance``.

    Raises:
        InputError: The frames have no steady direction at some angle.
        NoSolutionError: No table holds.
    """
    exact = exact_frames(machine)
    parts = 1 if machine.symmetry == "none" else 3
    coarser: list[FrameCandidate] = []
    for size in SIZES:
        table = table_of(exact, size, parts)
        candidate = FrameCandidate(table, errors_of(exact, table, machine.turns))
        if candidate.errors.torque <= tolerance:
            return FrameTables(
                candidate,
                tuple(coarser),
                exact.scale,
                machine.turns,
                machine.pole_pairs,
                tolerance,
            )
        coarser.append(candidate)
    raise NoSolutionError(
        f"waveform.error: with {SIZES[-1]} intervals the frame tables deviate by "
        f"{100.0 * coarser[-1].errors.torque:.2g} % of the torque; permit that, or leave "
        "export.frame_tables out"
    )


@on_design("export")
def solve_frame_tables(design: Design) -> FrameTables | None:
    """The tables that a design asks for, None where it asks for none.

    Raises:
        InputError: The machine has a sinusoidal back-EMF or saliency, or as `fit_frames`.
    """
    if not design.export.frame_tables:
        return None
    machine = design.phase_machine
    if machine is None or isinstance(machine, SalientPhaseMachine):
        raise InputError(f"export.frame_tables: {tables_obstacle(machine)}")
    return fit_frames(machine, design.waveform.error)


# What firmware of paper 002 needs of the frames dqx and dqy at an angle, exactly.
#
# Power-invariant and divided by a_x and a_y, as in paper 002 and in
# :mod:`dqforge.machines.phase_machines.frame_transforms`, where its misprints are listed.

DENSE = 23_040  # Angles of an electrical period at which tables are judged; all sizes divide it.

# Length of the alpha-beta vector of the back-EMF, of which the largest phase value is 1, below
# which the frames turn faster than a table follows.
LEAST_LENGTH = 0.05

# What a table holds, in its order: factors; angles in rad; 1 + theta_x' and theta_y'; a'/a in
# 1/rad; back-EMF of the qy axis over the electrical speed in Wb; coupling of dqy in H by row and
# column.
ANGLES = ("a_x", "a_y", "theta_x", "theta_y")
RATES = ("turn_x", "rate_y", "growth_x", "growth_y")
COUPLING = ("c_dd", "c_dq", "c_d0", "c_qd", "c_qq", "c_q0", "c_0d", "c_0q", "c_00")
COLUMNS = Frames._fields


@dataclass(frozen=True, slots=True, eq=False)
class ExactFrames:
    """The frames at M even angles over all turns.

    ``shape`` is the back-EMF over its largest phase value phi_m in Wb (`scale`), shape (3, M);
    ``columns`` the quantities of `COLUMNS`, shape (18, M).
    """

    scale: float
    shape: FloatArray
    columns: FloatArray


def exact_frames(machine: PhaseMachine) -> ExactFrames:
    """Everything at the dense angles.

    Raises:
        InputError: The frames have no direction at an angle, or turn too fast near it.
    """
    flux = resampled(machine.flux, machine.turns * DENSE)
    scale = float(np.max(np.abs(flux)))
    shape, theta = flux / scale, grid(machine.turns * DENSE, machine.turns)
    _require_length(shape, theta)
    slope = spectral_derivative(shape, machine.turns)
    rates = frame_rates(theta, shape, slope)
    _, size, zero = to_frame("dqx", theta, shape, shape)
    model = frame_model("dqy", theta, shape, slope, machine.l_s, machine.m_s, scaled=True)
    columns = (
        amplitude_factor("dqx", shape),
        amplitude_factor("dqy", shape),
        _unwrapped(theta, shape),
        np.arctan2(-size, zero),
        1.0 + rates.theta_x,
        rates.theta_y,
        rates.growth_x,
        rates.growth_y,
        scale * model.emf[:, 1],
        *np.moveaxis(model.coupling, 0, -1).reshape(9, -1),
    )
    return ExactFrames(scale, shape, np.stack(columns))


def torque_errors(shape: FloatArray, theta: FloatArray, found: FloatArray) -> tuple[float, float]:
    """Largest relative errors of the torque of currents that are constant in dqx and in dqy.

    Args:
        shape: Back-EMF shape at the angles, shape (3, M).
        theta: Electrical angles in rad, shape (M,).
        found: The first four of `COLUMNS` as the firmware reads them, shape (4, M).
    """
    a_x, a_y, theta_x, theta_y = found
    alpha, beta, zero = CLARKE @ shape
    ahead = np.cos(theta + theta_x) * beta - np.sin(theta + theta_x) * alpha
    of_x = a_x * ahead / POWER_INVARIANT - 1.0
    of_y = a_y * (np.cos(theta_y) * zero - np.sin(theta_y) * ahead) / POWER_INVARIANT - 1.0
    return float(np.max(np.abs(of_x))), float(np.max(np.abs(of_y)))


def _require_length(shape: FloatArray, theta: FloatArray) -> None:
    """Refuse an alpha-beta vector that comes near zero."""
    length = np.linalg.norm((CLARKE @ shape)[:2], axis=0)
    least = int(np.argmin(length))
    if length[least] < LEAST_LENGTH:
        raise InputError(
            "export.frame_tables: the alpha-beta vector of the back-EMF is as short as "
            f"{length[least]:.3g} of its largest phase value at {np.rad2deg(theta[least]):.0f} "
            f"degrees, {LEAST_LENGTH:g} are needed: dqx and dqy have no steady direction there; "
            "leave the key out and take the phase currents of <prefix>_waveform.h"
        )


def _unwrapped(theta: FloatArray, shape: FloatArray) -> FloatArray:
    """Angle theta_x in rad without jumps, which comes back to itself."""
    alpha, beta, _ = CLARKE @ shape
    direction = np.arctan2(-alpha, beta) - theta
    angle = np.unwrap(np.mod(direction + np.pi, 2.0 * np.pi) - np.pi)
    ahead = np.mod(angle[0] - angle[-1] + np.pi, 2.0 * np.pi) - np.pi
    if abs(angle[-1] + ahead - angle[0]) > np.pi:
        raise InputError(
            "export.frame_tables: the alpha-beta vector of the back-EMF does not turn once in an "
            "electrical period, as one of its harmonics outweighs the fundamental; leave the key "
            "out and take the phase currents of <prefix>_waveform.h"
        )
    return np.asarray(angle, dtype=np.float64)
