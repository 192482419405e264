"""The firmware form that phase currents get: candidates of every kind, what they err by,
and the smallest that holds.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

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
from dqforge.machines.transforms import Reals
from dqforge.optimizer.curves.single_precision import (
    CONTRACTED,
    SINGLE,
    SingleArray,
    between,
    compiled,
    interval,
    rest,
    within_turn,
)
from dqforge.optimizer.steps.step_arithmetic import Abc, Arithmetic
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
    over the requested torque.
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
    for o in (SINGLE, CONTRACTED):
        if isinstance(form, PhaseTable):
            turn = (theta / (2.0 * np.pi)).astype(np.float32)
            parts = form.step(o, form.place(o, turn), form.entries)
        else:
            turned = np.sin(theta).astype(np.float32), np.cos(theta).astype(np.float32)
            parts = form.step(o, *turned)
        found = np.stack(np.broadcast_arrays(*parts))
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

    def place(self, o: Arithmetic, turn: Reals) -> tuple[Any, Reals]:
        """The interval of turns from 0 to below 1, shape (M,), and the place counted in intervals.

        Others, and NaN, count as 0.
        """
        return interval(o, within_turn(o, turn), self.size)

    def step(self, o: Arithmetic, found: tuple[Any, Reals], rows: Any) -> Abc:
        """Currents per torque in A/(N m) at what `place` has found.

        Args:
            o: The arithmetic.
            found: Interval and place, shape (M,).
            rows: What stands for the rows of ``entries``.
        """
        (k, _), size, f = found, self.size, rest(o, *found)
        places: list[Any] = [k, k, k]
        if len(rows) == 1:  # b lags a by a third of a turn: two thirds ahead in the table.
            third = size // 3
            for phase, ahead in ((1, 2 * third), (2, third)):
                behind = size - ahead
                place = o.choose(k < behind, k + ahead, k - behind)
                places[phase] = o.let(f"k_{'abc'[phase]}", place)
        rows = [*rows] * (3 // len(rows))
        return Abc(
            *(
                between(o, f, o.at(row, place), o.at(row, place + 1))
                for row, place in zip(rows, places, strict=True)
            )
        )


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

    def step(self, o: Arithmetic, sine: Reals, cosine: Reals) -> Abc:
        """Currents per torque in A/(N m) at sine and cosine of the angle, shape (M,).

        What is zero is left out; the first product has nothing to be added to.
        """
        total: list[Any] = [None] * 3
        turned = _turned(o, self.stride, sine, cosine)
        for harmonic in range(self.size):
            order = 1 + self.stride * harmonic
            further = np.any(self.cosine[:, harmonic + 1 :]) or np.any(self.sine[:, harmonic + 1 :])
            for kind, weights in (("c", self.cosine), ("s", self.sine)):
                if further or np.any(weights[:, harmonic]):
                    turned(kind, harmonic)
            for phase, name in enumerate("abc"):
                for kind, weights in (("c", self.cosine), ("s", self.sine)):
                    weight = float(weights[phase, harmonic])
                    if weight != 0.0:
                        factor, now = turned(kind, harmonic), total[phase]
                        found = (
                            weight * factor if now is None else o.multiply_add(weight, factor, now)
                        )
                        total[phase] = o.let(f"i_{name}_{kind}{order}", found)
        return Abc(*(o.full(0.0, cosine) if part is None else part for part in total))


def _turned(o: Arithmetic, stride: int, sine: Reals, cosine: Reals) -> Callable[[str, int], Reals]:
    """What gives the cosine (``c``) or sine (``s``) of the angle times 1 + stride n, for n from 0
    on, each turned on from the one before, and none that nothing asks for.
    """
    known: dict[str, Reals] = {"c1": cosine, "s1": sine}
    if stride == 1:
        known |= {"step_c": cosine, "step_s": sine}

    def kept(name: str, value: Callable[[], Reals]) -> Reals:
        if name not in known:
            known[name] = o.let(name, value())
        return known[name]

    def step(kind: str) -> Reals:
        if kind == "c":
            double = lambda: o.multiply_add(cosine, cosine, o.negative(sine * sine))  # noqa: E731
        else:
            double = lambda: (cosine + cosine) * sine  # noqa: E731
        return kept(f"step_{kind}", double)

    def of(kind: str, n: int) -> Reals:
        def turned() -> Reals:
            c, s = of("c", n - 1), of("s", n - 1)
            step_c, step_s = step("c"), step("s")
            if kind == "c":
                return o.multiply_add(c, step_c, o.negative(s * step_s))
            return o.multiply_add(c, step_s, s * step_c)

        return kept(f"{kind}{1 + stride * n}", turned)

    return of


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

    def step(self, o: Arithmetic, torque: Reals, sine: Reals, cosine: Reals) -> Abc:
        """Currents per torque in A/(N m), at torques, sines and cosines of the angle,
        shapes (M,).
        """
        equal, weight_of = len(self.cosine) == 1, self._in_torque(o, torque)
        # Equal phases: what all share, what turns with phase a, and what
        # stands at right angles to that.
        sums: dict[str, Any] = {}

        def add(name: str, order: int, term: Any) -> None:
            found = o.total(name, sums[name], term) if name in sums else term
            sums[name] = o.let(f"{name}{order}", found)

        turned = _turned(o, self.stride, sine, cosine)

        def both(a: Any, b: Any, kinds: str, harmonic: int) -> Any:
            """A and b with cosine and sine, or sine and cosine; none without a weight."""
            then = None if b is None else o.product("", b, turned(kinds[1], harmonic))
            if a is None:
                return then
            first = turned(kinds[0], harmonic)
            return a * first if then is None else o.multiply_add(a, first, then)

        for harmonic in range(self.size):
            order = 1 + self.stride * harmonic
            for row, weights in enumerate(zip(self.cosine, self.sine, strict=True)):
                phase, kind = "" if equal else "abc"[row], order % 3
                crosses = equal and kind != 0
                for name, other, weight in zip("cs", "sc", weights, strict=True):
                    if weight[harmonic]:
                        turned(name, harmonic)
                        if crosses:
                            turned(other, harmonic)
                a, b = (
                    weight_of(f"{name}{order}{phase}", weight[harmonic])
                    for name, weight in zip("ab", weights, strict=True)
                )
                if a is None and b is None:
                    continue
                along = ("along" if kind else "common") if equal else f"i_{phase}"
                add(along, order, both(a, b, "cs", harmonic))
                if crosses:
                    back = None if b is None else o.negative(b)
                    across = both(a, back, "sc", harmonic)
                    add("across", order, across if kind == 1 else o.negative(across))
        zero = o.full(0.0, cosine)
        names = ("common", "along", "across") if equal else ("i_a", "i_b", "i_c")
        parts = [sums.get(name, zero) for name in names]
        if not equal:
            return Abc(*parts)
        common, along, across = parts
        half = o.let("half", o.multiply_add(-0.5, along, common))
        side = o.let("side", float(HALF_ROOT_3) * across)
        return Abc(common + along, half + side, half - side)

    def _in_torque(self, o: Arithmetic, torque: Reals) -> Callable[[str, tuple[float, ...]], Any]:
        """What gives a weight at the torque its name; None where there is none."""
        known: dict[str, Reals] = {}

        def argument(name: str) -> Reals:
            if name not in known:
                value = (
                    torque * float(self.inverse) if name == "x" else argument("x") * argument("x")
                )
                known[name] = o.let(name, value)
            return known[name]

        def weight_of(name: str, weight: tuple[float, ...]) -> Any:
            if not weight:
                return None
            (*rest, last), variable, odd = polynomial_steps(weight)
            value: Any = last if rest else o.full(last, torque)
            for coefficient in rest[::-1]:
                value = o.multiply_add(value, argument(variable), coefficient)
            return o.let(name, value * argument("x") if odd else value)

        return weight_of


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


PhaseForm = PhaseTable | PhaseHarmonics | PhasePolynomials


@dataclass(frozen=True, slots=True)
class PhaseReference:
    """A form with its domain: the torque is clamped to +-``torque_max`` N m."""

    form: PhaseForm
    torque_max: np.float32

    def step(
        self,
        o: Arithmetic,
        torque: Reals,
        angle: tuple[Reals, ...],
        end: Any,
        rows: Any = (),
    ) -> Abc:
        """Phase currents in A for torques in N m, shape (M,), which are clamped; 0 for NaN.

        Args:
            o: The arithmetic.
            torque: In N m.
            angle: (turn,) for a table, else (sine, cosine).
            end: What stands for ``torque_max``.
            rows: What stands for the rows of a table.
        """
        form = self.form
        found = form.place(o, angle[0]) if isinstance(form, PhaseTable) else None
        held = o.cases(
            "held",
            (torque <= end, lambda: torque),
            otherwise=lambda: o.choose(torque > end, end, o.full(0.0, torque)),
        )
        t = o.let("t", o.choose(held < -end, -end, held))
        if isinstance(form, PhaseTable):
            assert found is not None
            unit = form.step(o, found, rows)
        elif isinstance(form, PhasePolynomials):
            unit = form.step(o, t, *angle)
        else:
            unit = form.step(o, *angle)
        return Abc(*(t * part for part in unit))

    def currents(
        self, torque: SingleArray, angle: tuple[SingleArray, ...], *, fused: bool = False
    ) -> SingleArray:
        """Phase currents in A, shape (3, M), as the emitted C returns them, for float32
        torques in N m, shape (M,).

        ``angle`` is (turn,) for a table, else (sine, cosine). A turn outside 0 to 1, and NaN,
        count as 0.
        """
        rows = self.form.entries if isinstance(self.form, PhaseTable) else ()
        with np.errstate(invalid="ignore", under="ignore", over="ignore"):
            found = self.step(compiled(fused=fused), torque, angle, self.torque_max, rows)
        return np.stack(np.broadcast_arrays(*found))


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
