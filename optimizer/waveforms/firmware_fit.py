"""The firmware form that phase currents get: candidates of every kind, what they err by,
and the smallest that holds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import WaveformSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import WaveformForm
from dqforge.machines.phase_machines.frame_transforms import resampled
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies.topology import TOPOLOGIES
from dqforge.optimizer.curves.single_precision import fused_multiply_add, multiply_add
from dqforge.optimizer.waveforms.constraint_rows import WaveformLimits
from dqforge.optimizer.waveforms.firmware_form import (
    PhaseForm,
    PhaseHarmonics,
    PhaseReference,
    PhaseTable,
)
from dqforge.optimizer.waveforms.quadratic_problem import make_problem

TABLE_SIZES = (24, 48, 96, 192, 384, 768, 1536)


_MOST_ORDER = 99


_DENSE = 23_040


_SYMMETRIC = 1e-9


_ROUNDING = 1e-10


@dataclass(frozen=True, slots=True)
class PhaseErrors:
    """Largest errors found over a dense set of angles, with and without fused multiply-add:
    not bounds.

    ``current`` is that of a phase over the largest current, ``torque`` that of the torque
    over the torque asked for.
    """

    current: float
    torque: float
    samples: int


@dataclass(frozen=True, slots=True)
class PhaseCandidate:
    """One form that could be emitted: its errors, its bytes of constants, and its operations."""

    name: str
    form: PhaseForm
    errors: PhaseErrors
    flash: int
    operations: int


@dataclass(frozen=True, slots=True)
class PhaseFit:
    """The phase currents that are emitted, and the candidates they were chosen from,
    the chosen one first.
    """

    reference: PhaseReference
    candidates: tuple[PhaseCandidate, ...]
    torque_max: float

    @property
    def chosen(self) -> PhaseCandidate:
        """The candidate that is emitted."""
        return self.candidates[0]


def are_equal(waveform: FloatArray) -> bool:
    """Whether phases b and c are phase a a third of a turn later and earlier."""
    third = waveform.shape[1] // 3
    scale = _SYMMETRIC * float(np.max(np.abs(waveform)))
    later = np.max(np.abs(np.roll(waveform[0], third) - waveform[1])) <= scale
    return bool(later and np.max(np.abs(np.roll(waveform[0], -third) - waveform[2])) <= scale)


def make_table(unit: FloatArray, size: int, turns: int = 1) -> PhaseTable:
    """Table of currents per torque, shape (3, N) over ``turns`` electrical periods,
    with ``size`` intervals in each of them, a multiple of 3.
    """
    dense = max(_DENSE, size)
    values = resampled(unit, turns * dense)[:, :: dense // size]
    rows = _without_rounding(values[:1] if turns == 1 and are_equal(unit) else values)
    return PhaseTable(np.concatenate([rows, rows[:, :1]], axis=1).astype(np.float32))


def make_harmonics(unit: FloatArray, count: int, stride: int) -> PhaseHarmonics:
    """The first ``count`` harmonics of currents per torque, shape (3, N)."""
    lines = np.fft.rfft(unit, axis=-1)[:, 1 : 1 + stride * count : stride] * (2.0 / unit.shape[-1])
    parts = _without_rounding(np.stack([lines.real, -lines.imag])).astype(np.float32)
    return PhaseHarmonics(parts[0], parts[1], stride)


def _without_rounding(values: FloatArray) -> FloatArray:
    """Values in which what is nothing but rounding is zero."""
    return np.where(np.abs(values) > _ROUNDING * np.max(np.abs(values)), values, 0.0)


def phase_errors(
    machine: PhaseMachine, unit: FloatArray, form: PhaseTable | PhaseHarmonics
) -> PhaseErrors:
    """Errors of a form against currents per torque, shape (3, N), over a dense grid of angles."""
    dense = machine.turns * _DENSE
    exact, flux = resampled(unit, dense), resampled(machine.flux, dense)
    theta = 2.0 * np.pi * np.arange(dense) / dense  # over all turns
    current, torque = 0.0, 0.0
    for muladd in (multiply_add, fused_multiply_add):
        if isinstance(form, PhaseTable):
            found = form.unit_currents((theta / (2.0 * np.pi)).astype(np.float32), muladd)
        else:
            found = form.unit_currents(
                np.sin(theta).astype(np.float32), np.cos(theta).astype(np.float32), muladd
            )
        error = found.astype(np.float64) - exact
        current = max(current, float(np.max(np.abs(error)) / np.max(np.abs(exact))))
        torque = max(
            torque, float(np.max(np.abs(machine.pole_pairs * np.sum(flux * error, axis=0))))
        )
    return PhaseErrors(current, torque, 2 * dense)


def _candidate(
    machine: PhaseMachine, unit: FloatArray, name: str, form: PhaseTable | PhaseHarmonics
) -> PhaseCandidate:
    return PhaseCandidate(
        name, form, phase_errors(machine, unit, form), form.flash, form.operations
    )


def candidates(machine: PhaseMachine, unit: FloatArray, error: float) -> tuple[PhaseCandidate, ...]:
    """The smallest table and the fewest harmonics whose currents err by at
    most ``error`` of the peak.

    Where the pole pairs differ, there are tables over the mechanical turn alone: sine and cosine
    of the electrical angle do not tell which pole pair it is.
    """
    found = []
    for size in TABLE_SIZES:
        form = make_table(unit, size, machine.turns)
        table = _candidate(machine, unit, f"table of {form.size}", form)
        if table.errors.current <= error:
            found.append(table)
            break
    if machine.turns > 1:
        return tuple(found)
    lines = np.abs(np.fft.rfft(unit, axis=-1))
    stride = 2 if np.max(lines[:, 0::2]) <= _SYMMETRIC * np.max(lines) else 1
    has_mean = np.max(lines[:, 0]) > _SYMMETRIC * np.max(lines)
    for count in range(1, 1 if has_mean else _MOST_ORDER // stride + 1):
        harmonics = _candidate(
            machine, unit, f"{count} harmonics", make_harmonics(unit, count, stride)
        )
        if harmonics.errors.current <= error:
            found.append(harmonics)
            break
    return tuple(found)


def fit_phases(
    machine: PhaseMachine, limits: WaveformLimits, settings: WaveformSettings
) -> PhaseFit:
    """Phase currents per torque for the firmware: constant torque at least copper loss
    under the topology's rule.

    They are proportional to the torque, so that neither bus nor current limit enters but
    as the end of the domain.

    Raises:
        InputError: Harmonics are asked for, and the pole pairs differ.
        NoSolutionError: Constant torque cannot be made at some angle, or no form keeps the error.
    """
    if TOPOLOGIES[limits.topology].diodes:  # what they pass depends on torque and motion
        limits = replace(limits, topology="three-wire")
    problem = make_problem(machine, replace(limits, ripple=0.0, neutral=None, slew=None))
    unit = problem.currents(np.ones(1), np.zeros((1, problem.unknowns)))[0]
    torque_max = limits.i_max / float(np.max(np.abs(unit)))
    found = candidates(machine, unit, settings.error)
    wanted: dict[WaveformForm, type[PhaseForm] | None] = {
        "cheapest": None,
        "table": PhaseTable,
        "harmonics": PhaseHarmonics,
    }
    kind = wanted[settings.form]
    matching = [entry for entry in found if kind is None or isinstance(entry.form, kind)]
    if machine.turns > 1 and settings.form == "harmonics":
        raise InputError(
            "waveform.form: harmonics of the electrical angle do not tell which pole pair it is, "
            "and this machine's differ; write table"
        )
    if not matching:
        raise NoSolutionError(
            f"waveform.error: no {'form' if kind is None else settings.form} keeps "
            f"{100.0 * settings.error:.3g} % of the peak; permit a larger error or another form"
        )
    chosen = min(matching, key=lambda entry: (entry.operations, entry.flash))
    rest = tuple(entry for entry in found if entry is not chosen)
    return PhaseFit(
        PhaseReference(chosen.form, np.float32(torque_max)), (chosen, *rest), torque_max
    )
