"""Tables of the frames dqx and dqy with linear interpolation: sizes, errors, and the smallest
that holds.
"""

from __future__ import annotations

import numpy as np

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.phase_machines.frame_choice import tables_obstacle
from dqforge.machines.phase_machines.phase_machine import PhaseMachine, grid
from dqforge.machines.phase_machines.salient_phase_machine import SalientPhaseMachine
from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import (
    MultiplyAdd,
    SingleArray,
    fused_multiply_add,
    multiply_add,
)
from dqforge.optimizer.frame_tables.exact_frames import (
    ANGLES,
    COLUMNS,
    COUPLING,
    DENSE,
    RATES,
    ExactFrames,
    exact_frames,
    torque_errors,
)

SIZES = (48, 96, 192, 384, 768, 1536)  # Intervals of an electrical period.
_FLOAT_BYTES = 4
_LEAST_SCALE = 1e-9


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

    def values(self, turn: SingleArray, muladd: MultiplyAdd = multiply_add) -> SingleArray:
        """What the emitted C reads, shape (18, M), at turns from 0 to below 1, shape (M,).

        Others, and NaN, count as 0.
        """
        inside = (turn >= 0.0) & (turn < 1.0)
        x = np.where(inside, turn, np.float32(0.0)).astype(np.float32)
        if self.parts == 3:
            x = x * np.float32(3.0)
            x = np.where(x >= 2.0, x - np.float32(2.0), x)
            x = np.where(x >= 1.0, x - np.float32(1.0), x).astype(np.float32)
        place = x * np.float32(self.size)
        index = np.minimum(place.astype(np.int64), self.size - 1)
        share = place - index.astype(np.float32)
        before, behind = self.entries[index].T, self.entries[index + 1].T
        return np.asarray(muladd(share, behind - before, before), dtype=np.float32)


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
    for muladd in (multiply_add, fused_multiply_add):
        found = table.values(turn, muladd).astype(np.float64)
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
        f"waveform.error: with {SIZES[-1]} intervals the frame tables err by "
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
