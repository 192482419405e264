"""Overmodulation on the voltage hexagon: the vector that the duty cycles make of one beyond it, up
to six-step operation, with the fundamental that was asked for.

A vector of the amplitude m (over v_dc) is asked for; while it turns, the method is fed a circle of
another radius, so that the fundamental of what it makes is m. Two methods::

    least phase error      the vector is shortened along its direction onto the hexagon; from
                           sqrt(3) ln(3) / pi = 0.6057 on its place along the side is stretched
                           from the middle, and the corners are held
    least magnitude error  the end of the vector moves to the nearest point of the hexagon; from
                           1/3 + sqrt(3) / (2 pi) = 0.6090 on that is a corner some of the time

The radius fed, and the reciprocals that rise without bound towards six-step operation, are
polynomials of a square root: in it they are smooth up to the end, where their slope over m is
infinite.

References:
    J. Holtz, W. Lotzkat, A. M. Khambadkone, "On continuous control of PWM inverters in the
    overmodulation range including the six-step mode", IEEE Transactions on Power Electronics 8(4),
    1993, doi:10.1109/63.261026 (two ranges, hold of the corners). A. M. Hava, R. J. Kerkman, T. A.
    Lipo, "Carrier-based PWM-VSI overmodulation strategies: analysis, comparison, and design", IEEE
    Transactions on Power Electronics 13(4), 1998, doi:10.1109/63.704136 (least magnitude error is
    what saturated space-vector modulation does). The polynomials and the stretched side are our
    own.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from dqforge.machines.modulation.registry import MODULATORS
from dqforge.machines.names import ModulationName, OvermodulationName
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import Floats, Pair, Reals, clarke_inverse

# Radius over v_dc of the circle in the hexagon: the largest fundamental without overmodulation.
INSCRIBED = 1.0 / math.sqrt(3.0)

# Fundamental over v_dc of a vector that follows the hexagon at constant speed, 0.6057.
HEXAGON = math.sqrt(3.0) * math.log(3.0) / math.pi
SIX_STEP = 2.0 / math.pi  # Fundamental over v_dc of six-step operation.

# Least of the reciprocals that go to zero at six-step operation; it leaves a fundamental of 1e-7
# less.
LEAST_HOLD = 1.0e-3


@dataclass(frozen=True, slots=True)
class HexagonMethod:
    """One method of overmodulation.

    Args:
        name: As in a design file.
        text: What it does, in a line.
        radial: Whether the vector is shortened along its direction.
        turning: Fundamental over v_dc from which on corners are held.
        arc_end: Fundamental whose distance from m goes into the root of ``arc``.
        arc: Polynomial of sqrt(arc_end - m), lowest power first: radius over v_dc of the circle
            that the method is fed below ``turning``.
        hold: Polynomial of sqrt(SIX_STEP - m), lowest power first, from ``turning`` on. Least phase
            error: reciprocal of the stretch along the side. Least magnitude error: v_dc over the
            radius of the circle.
    """

    name: OvermodulationName
    text: str
    radial: bool
    turning: float
    arc_end: float
    arc: tuple[float, ...]
    hold: tuple[float, ...]


# Fitted in the largest relative error of the fundamental: 3e-5 (arc) and 3e-6 (hold) with least
# phase error, 2.5e-5 and 4e-7 with least magnitude error; float32 as they are written.
# The methods by name.
METHODS: Mapping[OvermodulationName, HexagonMethod] = MappingProxyType(
    {
        "least-phase-error": HexagonMethod(
            name="least-phase-error",
            text="the vector is shortened along its direction onto the hexagon",
            radial=True,
            turning=HEXAGON,
            arc_end=HEXAGON,
            arc=(0.6677227, -0.7014633, 1.8265866, -10.255876, 30.964746),
            hold=(-0.0006543373, 5.3520765, -0.53342336, 13.968511),
        ),
        "least-magnitude-error": HexagonMethod(
            name="least-magnitude-error",
            text="the end of the vector moves to the nearest point of the hexagon",
            radial=False,
            turning=1.0 / 3.0 + math.sqrt(3.0) / (2.0 * math.pi),
            arc_end=0.6109,
            arc=(0.71753544, -1.4505526, 7.8532286, -35.459316, 71.005295),
            hold=(0.00015003931, 9.201491, 0.13618897, -7.227792),
        ),
    }
)


def follows_hexagon(modulation: ModulationName) -> bool:
    """Whether a modulator's duty cycles make every vector of the hexagon.

    Those that add nothing or a third harmonic do not: at the corners their zero sequence would take
    two phases beyond the rails.

    Args:
        modulation: The modulator.
    """
    return MODULATORS[modulation].kind not in ("sine", "third-harmonic")


def overmodulated(name: OvermodulationName, vector: Pair[Reals], v_dc: Reals) -> Pair[Reals]:
    """What the duty cycles make of voltage vectors: the same within the circle in the hexagon,
    beyond it a vector on the hexagon or within, by the method.

    The operations and their order are those of the emitted C, of which this is the model in
    float32.

    Args:
        name: The method; ``none`` leaves the vectors as they are.
        vector: Alpha and beta in V, arrays of one floating-point type and shape (...).
        v_dc: DC-link voltage in V, of the same type, shape (...). Without it nothing is changed.
    """
    if name == "none":
        return vector
    square = (vector.x * vector.x) + (vector.y * vector.y)
    number = square.dtype.type
    beyond = (v_dc > number(0.0)) & (square > number(1.0 / 3.0) * (v_dc * v_dc))
    if not np.any(beyond):
        return vector
    inner = Pair(*(np.where(beyond, axis, number(0.5)) for axis in vector))
    link = np.where(beyond, v_dc, number(1.0))
    index = np.sqrt(np.where(beyond, square, number(1.0))) / link
    made = _on_hexagon(METHODS[name], inner, link, index)
    return Pair(*(np.where(beyond, new, old) for new, old in zip(made, vector, strict=True)))


def _on_hexagon(
    method: HexagonMethod, vector: Pair[Reals], v_dc: Reals, index: Reals
) -> Pair[Reals]:
    """Vectors that all lie beyond the circle in the hexagon; ``index`` is their length over
    v_dc.
    """
    number = index.dtype.type
    middle, side, in_middle = _nearest_side(vector)
    span = np.abs(side)
    held = ~(index < number(method.turning))
    gain = _polynomial(method.arc, number(method.arc_end) - index) / index
    hold = _polynomial(method.hold, number(SIX_STEP) - index)
    hold = np.where(hold < number(LEAST_HOLD), number(LEAST_HOLD), hold)
    inside = ~held & ~(gain * span > v_dc)
    if method.radial:
        gain = np.where(inside, gain, v_dc / span)
        turned = ~held
        along = (middle * v_dc) / (span * hold)
    else:
        turned = inside
        along = np.where(held, middle / (index * hold), gain * middle)
    corner = number(1.0 / 3.0) * v_dc
    along = np.where(along > corner, corner, np.where(along < -corner, -corner, along))
    whole = np.where(side < number(0.0), -v_dc, v_dc)
    x, y = _on_side(along, whole, in_middle)
    return Pair(np.where(turned, gain * vector.x, x), np.where(turned, gain * vector.y, y))


def _polynomial(coefficients: tuple[float, ...], distance: Reals) -> Reals:
    """A polynomial of the root of a distance, which counts as 0 where it is negative."""
    number = distance.dtype.type
    root = np.sqrt(np.where(distance > number(0.0), distance, number(0.0)))
    value = np.full_like(root, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = number(coefficient) + (value * root)
    return np.asarray(value)


def _nearest_side(vector: Pair[Reals]) -> tuple[Reals, Reals, tuple[Any, Any]]:
    """Voltage of the phase between the two others, the difference of these, and whether that
    phase is a, and whether it is b.
    """
    v = clarke_inverse(Floats(vector.x.dtype.type), vector)
    ab, bc, ca = v.a - v.b, v.b - v.c, v.c - v.a
    is_a = (np.abs(bc) >= np.abs(ab)) & (np.abs(bc) >= np.abs(ca))
    is_b = ~is_a & (np.abs(ca) >= np.abs(ab))
    middle = np.where(is_a, v.a, np.where(is_b, v.b, v.c))
    side = np.where(is_a, bc, np.where(is_b, -ca, ab))
    return middle, side, (is_a, is_b)


def _on_side(along: Reals, whole: Reals, in_middle: tuple[Any, Any]) -> Pair[Reals]:
    """Alpha and beta of a voltage of the middle phase and a difference of the two others."""
    number = along.dtype.type
    is_a, is_b = in_middle
    half, root = number(0.5), number(1.0 / math.sqrt(3.0))
    x = np.where(is_a, along, half * (whole - along))
    across = ((half * whole) + (number(1.5) * along)) * root
    y = np.where(is_a, root * whole, np.where(is_b, across, -across))
    return Pair(x, y)
