"""Phase currents per torque as the firmware evaluates them: a table over the angle, harmonics,
or such over torque.

As for the current references, each form is the list of float32 operations
that the header spells out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.records import dataclass
from dqforge.optimizer.curves.single_precision import (
    MultiplyAdd,
    SingleArray,
    fused_multiply_add,
    multiply_add,
)

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
