"""Thermal networks from junction to case: Foster and Cauer form, exact conversion, step response.

Sources: JEDEC JESD51-14 (2010), annex on the conversion of Foster into Cauer networks;
IEC 60747-15 on the impedance.
"""

from __future__ import annotations

import math
from decimal import Decimal, localcontext
from fractions import Fraction

import numpy as np
from numpy.typing import ArrayLike

from dqforge.machines.arrays import FloatArray
from dqforge.machines.errors import InputError
from dqforge.machines.records import dataclass

_DIGITS = 120


_STEPS = 60


_MOST_ELEMENTS = 20


def _check(
    resistances: tuple[float, ...], seconds: tuple[float, ...], name: str, least: float
) -> None:
    """Refuse a network that no body has."""
    if not resistances or len(resistances) != len(seconds):
        message = f"the network has {len(resistances)} resistances and {len(seconds)} {name}"
        raise InputError(f"{message}; write one of each per element")
    if len(resistances) > _MOST_ELEMENTS:
        raise InputError(
            f"the network has more than {_MOST_ELEMENTS} elements; write the largest ones"
        )
    for k, (resistance, second) in enumerate(zip(resistances, seconds, strict=True)):
        if not 0.0 < resistance < math.inf:
            raise InputError(
                f"resistance {k} of the network is {resistance:g} K/W; write a positive number"
            )
        if not least <= second < math.inf or (second == 0.0 and least > 0.0):
            raise InputError(f"element {k} of the {name} is {second:g}; write a positive number")


@dataclass(frozen=True, slots=True)
class FosterNetwork:
    """Partial fractions of the thermal impedance: Z(s) = sum R_i / (1 + s tau_i).

    Its nodes are no places in the body.

    Args:
        resistances: R_i in K/W, positive.
        time_constants: tau_i in s; zero where only the resistance is known.
    """

    resistances: tuple[float, ...]
    time_constants: tuple[float, ...]

    def __post_init__(self) -> None:
        _check(self.resistances, self.time_constants, "time constants", 0.0)

    @property
    def resistance(self) -> float:
        """Resistance in the steady state in K/W."""
        return math.fsum(self.resistances)

    def step_response(self, time: ArrayLike) -> FloatArray:
        """Z_th in K/W at times in s of any shape, (...): temperature rise over a
        power that begins at zero.
        """
        moment = np.maximum(np.asarray(time, dtype=np.float64), 0.0)
        total = np.zeros(moment.shape)
        for resistance, constant in zip(self.resistances, self.time_constants, strict=True):
            # Without capacity the rise is there at once, at t = 0+.
            total = total + (
                resistance if constant == 0.0 else -resistance * np.expm1(-moment / constant)
            )
        return np.asarray(total)

    def cauer(self) -> CauerNetwork:
        """The ladder with the same impedance, in exact rational arithmetic and rounded once.

        Raises:
            InputError: An element has no time constant, so that there is no capacity at the
                junction.
        """
        if 0.0 in self.time_constants:
            raise InputError(
                "a network without time constants has no Cauer form; write tau of each element"
            )
        merged: dict[float, Fraction] = {}
        for resistance, constant in zip(self.resistances, self.time_constants, strict=True):
            # Two elements of one time constant are one pole.
            merged[constant] = merged.get(constant, Fraction(0)) + Fraction(resistance)
        numerator, denominator = [Fraction(0)], [Fraction(1)]
        for constant, whole in merged.items():
            factor = [Fraction(1), Fraction(constant)]
            numerator = _sum(_product(numerator, factor), [whole * part for part in denominator])
            denominator = _product(denominator, factor)
        resistances, capacities = [], []
        # Continued fraction: Y = s C_1 + 1 / (R_1 + 1 / (s C_2 + ...)), one element per turn.
        while len(numerator) > 0 and len(denominator) == len(numerator) + 1:
            capacity = denominator[-1] / numerator[-1]
            rest = _sum(denominator, [Fraction(0)] + [-capacity * part for part in numerator])
            series = numerator[-1] / rest[-1]
            capacities.append(float(capacity))
            resistances.append(float(series))
            numerator, denominator = _sum(numerator, [-series * part for part in rest]), rest
        return CauerNetwork(tuple(resistances), tuple(capacities))


@dataclass(frozen=True, slots=True)
class CauerNetwork:
    """Ladder from the junction to the case: capacity C_i to the case, then R_i to the next node.

    Args:
        resistances: R_i in K/W, positive, from the junction outwards.
        capacities: C_i in J/K, positive.
    """

    resistances: tuple[float, ...]
    capacities: tuple[float, ...]

    def __post_init__(self) -> None:
        _check(self.resistances, self.capacities, "capacities", 1e-300)

    @property
    def resistance(self) -> float:
        """Resistance in the steady state in K/W."""
        return math.fsum(self.resistances)

    def step_response(self, time: ArrayLike) -> FloatArray:
        """Z_th in K/W at times in s of any shape, (...): temperature rise over a
        power that begins at zero.
        """
        return self.foster().step_response(time)

    def matrix(self) -> FloatArray:
        """System matrix A in 1/s of dT/dt = A T + B P with B = (1/C_1, 0, ...), shape (N, N)."""
        size = len(self.resistances)
        conductance = np.zeros((size, size))
        for k, resistance in enumerate(self.resistances):
            conductance[k, k] += 1.0 / resistance
            if k + 1 < size:
                conductance[k + 1, k + 1] += 1.0 / resistance
                conductance[k, k + 1] = conductance[k + 1, k] = -1.0 / resistance
        return np.asarray(-conductance / np.asarray(self.capacities)[:, None], dtype=np.float64)

    def foster(self) -> FosterNetwork:
        """Partial fractions of the same impedance.

        The poles are eigenvalues of the ladder, refined by Newton's method on its exact
        characteristic polynomial: eigenvalues alone would be good to rounding of the fastest one
        only, which the slowest may lie far below.
        """
        numerator, denominator = [Fraction(0)], [Fraction(1)]
        for resistance, capacity in zip(
            reversed(self.resistances), reversed(self.capacities), strict=True
        ):
            # Z = 1 / (s C + 1 / (R + Z_next)), from the case inwards.
            series = _sum(numerator, [Fraction(resistance) * part for part in denominator])
            shunt = [Fraction(0)] + [Fraction(capacity) * part for part in series]
            numerator, denominator = series, _sum(denominator, shunt)
        scale = 1.0 / np.sqrt(np.asarray(self.capacities))
        symmetric = -self.matrix() * np.asarray(self.capacities)[:, None] * np.outer(scale, scale)
        starts = np.linalg.eigvalsh(symmetric)
        with localcontext() as context:
            context.prec = _DIGITS
            above, below = (
                [Decimal(part.numerator) / part.denominator for part in side]
                for side in (numerator, denominator)
            )
            poles = [_newton(below, -Decimal(float(start))) for start in starts]
            slope = _derivative(below)
            found = sorted(
                (float(-1 / pole), float(_value(above, pole) / _value(slope, pole) / -pole))
                for pole in poles
            )
        return FosterNetwork(tuple(pair[1] for pair in found), tuple(pair[0] for pair in found))


ThermalNetwork = FosterNetwork | CauerNetwork


def _product(left: list[Fraction], right: list[Fraction]) -> list[Fraction]:
    """Product of two polynomials, lowest power first."""
    result = [Fraction(0)] * (len(left) + len(right) - 1)
    for k, a in enumerate(left):
        for j, b in enumerate(right):
            result[k + j] += a * b
    return result


def _sum(left: list[Fraction], right: list[Fraction]) -> list[Fraction]:
    """Sum of two polynomials, lowest power first."""
    size = max(len(left), len(right))
    padded = [side + [Fraction(0)] * (size - len(side)) for side in (left, right)]
    return _trimmed([a + b for a, b in zip(*padded, strict=True)])


def _trimmed(polynomial: list[Fraction]) -> list[Fraction]:
    """Polynomial without leading zeros."""
    while polynomial and polynomial[-1] == 0:
        polynomial = polynomial[:-1]
    return polynomial


def _value(polynomial: list[Decimal], where: Decimal) -> Decimal:
    """Value of a polynomial, by Horner."""
    total = Decimal(0)
    for part in reversed(polynomial):
        total = total * where + part
    return total


def _derivative(polynomial: list[Decimal]) -> list[Decimal]:
    """Derivative of a polynomial."""
    return [k * part for k, part in enumerate(polynomial)][1:]


def _newton(polynomial: list[Decimal], start: Decimal) -> Decimal:
    """Root near a good start."""
    slope, root = _derivative(polynomial), start
    for _ in range(_STEPS):
        step = _value(polynomial, root) / _value(slope, root)
        root -= step
        if abs(step) <= abs(root) * Decimal(10) ** -40:
            break
    return root
