"""The firmware form that phase currents get: candidates of every kind, what they err by,
and the smallest that holds.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.arrays import FloatArray
from dqforge.machines.design.settings import WaveformSettings
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import WaveformForm
from dqforge.machines.phase_machines.frame_transforms import resampled
from dqforge.machines.phase_machines.phase_machine import PhaseMachine
from dqforge.machines.records import dataclass
from dqforge.machines.topologies import TOPOLOGIES
from dqforge.optimizer.curves.integer_polynomial import (
    MultiplyAdd,
    SingleArray,
    fused_multiply_add,
    multiply_add,
)
from dqforge.optimizer.waveforms.constraint_rows import WaveformLimits, make_problem

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


# Phase currents per torque as the firmware evaluates them: a table over the angle, harmonics,
# or such over torque.
#
# As for the current references, each form is the list of float32 operations
# that the header spells out.

_FLOAT_BYTES = 4


@dataclass(frozen=True, slots=True)
class PhaseTable:
    """Linear interpolation in a table over the electrical turn, or, where the pole pairs differ,
    over the mechanical one.

    ``entries`` in A/(N m), shape (1, N + 1) for three equal phases, of which b and c are read a
    third of a turn behind and before a, or (3, N + 1), as always over the mechanical turn; the last
    column repeats the first.
    """

    entries: SingleArray

    @property
    def size(self) -> int:
        """Number N of intervals."""
        return int(self.entries.shape[1]) - 1

    @property
    def flash(self) -> int:
        """Bytes of constants."""
        return _FLOAT_BYTES * int(self.entries.size)

    @property
    def operations(self) -> int:
        """Arithmetic operations and loads of one evaluation of three currents."""
        return 26

    def unit_currents(self, turn: SingleArray, muladd: MultiplyAdd) -> SingleArray:
        """Currents per torque in A/(N m), shape (3, M), at turns from 0 to below 1, shape (M,)."""
        place = turn * np.float32(self.size)
        index = np.minimum(place.astype(np.int64), self.size - 1)
        share = place - index.astype(np.float32)
        rows = []
        for phase in range(3):
            equal = self.entries.shape[0] == 1
            row = self.entries[0 if equal else phase]
            # b lags a by a third of a turn: two thirds ahead in the table.
            here = (
                (index + (self.size - self.size * phase // 3) % self.size) % self.size
                if equal
                else index
            )
            rows.append(muladd(share, row[here + 1] - row[here], row[here]))
        return np.stack(rows)


@dataclass(frozen=True, slots=True)
class PhaseHarmonics:
    """Harmonics of orders 1, 1 + stride, ... up to H of them, from sine and cosine of the angle.

    ``cosine`` and ``sine`` in A/(N m), shape (3, H): i_k / torque = sum cosine_kh cos(h
    theta) + sine_kh sin(h theta).
    """

    cosine: SingleArray
    sine: SingleArray
    stride: int

    @property
    def size(self) -> int:
        """Number H of harmonics."""
        return int(self.cosine.shape[1])

    @property
    def flash(self) -> int:
        """Bytes of constants."""
        return _FLOAT_BYTES * int(np.count_nonzero(self.cosine) + np.count_nonzero(self.sine))

    @property
    def operations(self) -> int:
        """Arithmetic operations and loads of one evaluation of three currents."""
        return (
            6
            + 6 * (self.size - 1)
            + 2 * int(np.count_nonzero(self.cosine) + np.count_nonzero(self.sine))
        )

    def unit_currents(
        self, sine: SingleArray, cosine: SingleArray, muladd: MultiplyAdd
    ) -> SingleArray:
        """Currents per torque in A/(N m), shape (3, M), at sine and cosine of the angle,
        shape (M,).
        """
        if self.stride == 2:
            step_c = muladd(cosine, cosine, -(sine * sine))
            step_s = (cosine + cosine) * sine
        else:
            step_c, step_s = cosine, sine
        c, s = cosine, sine
        total: list[SingleArray | None] = [None] * 3
        for harmonic in range(self.size):
            if harmonic:
                c, s = muladd(c, step_c, -(s * step_s)), muladd(c, step_s, s * step_c)
            for phase in range(3):
                # What is zero is left out of the emitted C; the first product
                # has nothing to be added to.
                for weight, factor in (
                    (self.cosine[phase, harmonic], c),
                    (self.sine[phase, harmonic], s),
                ):
                    if weight != 0.0:
                        spread = np.broadcast_to(weight, factor.shape)
                        before = total[phase]
                        total[phase] = (
                            spread * factor if before is None else muladd(spread, factor, before)
                        )
        return np.stack([np.zeros_like(cosine) if part is None else part for part in total])


# Ascending coefficients of polynomials, float32 values, by row and harmonic; empty where there is
# none.
Weights = tuple[tuple[tuple[float, ...], ...], ...]
HALF_ROOT_3 = np.float32(0.5 * np.sqrt(3.0))


@dataclass(frozen=True, slots=True)
class PhasePolynomials:
    """Harmonics of orders 1, 1 + stride, ... whose weights are polynomials in x =
    ``inverse`` times the torque.

    ``cosine`` and ``sine`` in A/(N m) have one row for three equal phases, of which b and c lag by
    120 and 240 degrees, else three: i_k / torque = sum cosine_kh(x) cos(h theta) + sine_kh(x) sin(h
    theta). ``inverse`` in 1/(N m).
    """

    cosine: Weights
    sine: Weights
    stride: int
    inverse: np.float32

    @property
    def size(self) -> int:
        """Number H of harmonics."""
        return len(self.cosine[0])

    @property
    def degree(self) -> int:
        """Largest degree in the torque."""
        return max(len(weight) for weight in self._weights) - 1

    @staticmethod
    def steps(weight: tuple[float, ...]) -> tuple[tuple[float, ...], str, bool]:
        """How the firmware evaluates one weight, as `polynomial_steps` says."""
        return polynomial_steps(weight)

    @property
    def _weights(self) -> list[tuple[float, ...]]:
        return [weight for part in (self.cosine, self.sine) for row in part for weight in row]

    @property
    def flash(self) -> int:
        """Bytes of constants."""
        return _FLOAT_BYTES * (1 + sum(int(np.count_nonzero(weight)) for weight in self._weights))

    @property
    def operations(self) -> int:
        """Arithmetic operations and loads of one evaluation of three currents."""
        steps = sum(3 * len(polynomial_steps(weight)[0]) for weight in self._weights if weight)
        used = sum(1 for weight in self._weights if weight)
        return (
            7 + 6 * (self.size - 1) + steps + (4 * used + 6 if len(self.cosine) == 1 else 2 * used)
        )

    def unit_currents(
        self, torque: SingleArray, sine: SingleArray, cosine: SingleArray, muladd: MultiplyAdd
    ) -> SingleArray:
        """Currents per torque in A/(N m), shape (3, M), at torques, sines and cosines of the angle,
        shapes (M,).
        """
        x = torque * self.inverse
        square = x * x
        equal = len(self.cosine) == 1
        # Equal phases: what all share, what turns with phase a, and what
        # stands at right angles to that.
        sums: list[SingleArray | None] = [None] * 3
        step_c, step_s = cosine, sine
        if self.stride == 2:
            step_c, step_s = muladd(cosine, cosine, -(sine * sine)), (cosine + cosine) * sine
        c, s = cosine, sine
        for harmonic in range(self.size):
            if harmonic:
                c, s = muladd(c, step_c, -(s * step_s)), muladd(c, step_s, s * step_c)
            for row, weights in enumerate(zip(self.cosine, self.sine, strict=True)):
                parts = [polynomial(weight[harmonic], x, square, muladd) for weight in weights]
                along, across = _turned(parts[0], parts[1], c, s, muladd)
                if along is None or across is None:
                    continue
                kind = (1 + harmonic * self.stride) % 3
                _add(sums, (0 if kind == 0 else 1) if equal else row, along)
                if equal and kind:
                    _add(sums, 2, across if kind == 1 else -across)
        rows = [np.zeros_like(cosine) if part is None else part for part in sums]
        if not equal:
            return np.stack(rows)
        common, along, across = rows
        half, side = muladd(np.full_like(along, -0.5), along, common), HALF_ROOT_3 * across
        return np.stack([common + along, half + side, half - side])


def polynomial_steps(weight: tuple[float, ...]) -> tuple[tuple[float, ...], str, bool]:
    """Coefficients for Horner's rule, ascending, its variable (``x`` or ``square``),
    and whether x multiplies the end.

    Where every other coefficient is zero, half the steps remain.
    """
    if not any(weight[1::2]):
        return weight[0::2], "square", False
    if not any(weight[0::2]):
        return weight[1::2], "square", True
    return weight, "x", False


def polynomial(
    weight: tuple[float, ...], x: SingleArray, square: SingleArray, muladd: MultiplyAdd
) -> SingleArray | None:
    """Value of a polynomial in float32, shape (M,); None where there is none."""
    if not weight:
        return None
    coefficients, variable, odd = polynomial_steps(weight)
    by = square if variable == "square" else x
    value = np.full_like(x, np.float32(coefficients[-1]))
    for coefficient in coefficients[-2::-1]:
        value = muladd(value, by, np.asarray(coefficient, dtype=np.float32))
    return value * x if odd else value


def _turned(
    a: SingleArray | None,
    b: SingleArray | None,
    c: SingleArray,
    s: SingleArray,
    muladd: MultiplyAdd,
) -> tuple[SingleArray | None, SingleArray | None]:
    """A c + b s, and a s - b c; terms without a weight are left out."""
    if a is None:
        return (None, None) if b is None else (b * s, -(b * c))
    if b is None:
        return a * c, a * s
    return muladd(a, c, b * s), muladd(a, s, -(b * c))


def _add(sums: list[SingleArray | None], place: int, term: SingleArray) -> None:
    before = sums[place]
    sums[place] = term if before is None else before + term


PhaseForm = PhaseTable | PhaseHarmonics | PhasePolynomials


@dataclass(frozen=True, slots=True)
class PhaseReference:
    """A form with its domain: the torque is clamped to +-``torque_max`` N m."""

    form: PhaseForm
    torque_max: np.float32

    def currents(
        self, torque: SingleArray, angle: tuple[SingleArray, ...], *, fused: bool = False
    ) -> SingleArray:
        """Phase currents in A, shape (3, M), as the emitted C returns them, for float32
        torques in N m, shape (M,).

        ``angle`` is (turn,) for a table, else (sine, cosine). A turn outside 0 to 1, and NaN,
        count as 0.
        """
        muladd = fused_multiply_add if fused else multiply_add
        with np.errstate(invalid="ignore", under="ignore", over="ignore"):
            limited = np.where(torque > self.torque_max, self.torque_max, torque)
            limited = np.where(limited < -self.torque_max, -self.torque_max, limited)
            limited = np.where(np.isnan(limited), np.float32(0.0), limited).astype(np.float32)
            if isinstance(self.form, PhaseTable):
                (turn,) = angle
                inside = (turn >= 0.0) & (turn < 1.0)
                unit = self.form.unit_currents(
                    np.where(inside, turn, np.float32(0.0)).astype(np.float32), muladd
                )
            else:
                sine, cosine = angle
                if isinstance(self.form, PhasePolynomials):
                    unit = self.form.unit_currents(limited, sine, cosine, muladd)
                else:
                    unit = self.form.unit_currents(sine, cosine, muladd)
            return np.asarray(limited * unit, dtype=np.float32)


def sample_angles(form: PhaseForm, count: int, seed: int) -> tuple[NDArray[np.float32], ...]:
    """Angles as the evaluator takes them: (turn,) or (sine, cosine), special values first,
    shape (count,).
    """
    generator = np.random.default_rng(seed)
    turn = generator.uniform(0.0, 1.0, count).astype(np.float32)
    below_one = np.nextafter(np.float32(1.0), np.float32(0.0))
    special = np.array(
        [0.0, -0.0, below_one, 1.0, -0.25, np.nan, 1e30, 1.0 / 3.0, 0.5, 1e-40], dtype=np.float32
    )
    if isinstance(form, PhaseTable):
        turn[: special.size] = special
        return (turn,)
    theta = 2.0 * np.pi * turn.astype(np.float64)
    return np.sin(theta).astype(np.float32), np.cos(theta).astype(np.float32)
