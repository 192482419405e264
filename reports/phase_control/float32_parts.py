"""Shape, references, frames and harmonic integrators of the control of phase machines on numpy
arrays of float32: as ``references.j2``, ``frame.j2`` and ``harmonics.j2``, same bits.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dqforge.machines.transforms import Triple, clarke
from dqforge.optimizer.curves.single_precision import SingleArray
from dqforge.reports.c_code.float32_functions import SINGLE
from dqforge.reports.phase_control.float32_duties import Stationary

Turn = tuple[SingleArray, SingleArray]
Gains = Mapping[str, Any]

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_FAR = np.float32(65536.0)
_LEAST_SQUARE, _LEAST = np.float32(1.0e-18), np.float32(1.0e-9)
_ROOT_2, _HALF_ROOT_2 = np.float32(1.4142135), np.float32(0.70710677)
_THIRD = np.float32(0.33333334)


def turned(x: Turn, y: Turn) -> Turn:
    """Cosine and sine of the sum of two angles."""
    return (x[0] * y[0]) - (x[1] * y[1]), (x[1] * y[0]) + (x[0] * y[1])


def mean_of_phases(x: Triple[SingleArray]) -> SingleArray:
    """The zero sequence."""
    return _THIRD * ((x.a + x.b) + x.c)


def shape_at(
    shape: SingleArray, place: SingleArray, opened: NDArray[np.uint32] | None
) -> Stationary:
    """Back-EMF over electrical speed in Wb.

    Parameters
    ----------
    shape:
        Table, shape (1 or 3, N + 1), the last column as the first.
    place:
        Where to read, in lengths of the table, shape (M,).
    opened:
        Phase without current, 1 to 3, 0 for none; None where no phase can be open.
    """
    nodes = shape.shape[1] - 1
    known = (place < _FAR) & (place > -_FAR)
    x = np.where(known, place, _ZERO)
    x = x - x.astype(np.int64).astype(np.float32)
    x = np.where(x < _ZERO, x + _ONE, x) * np.float32(nodes)
    k = np.minimum(x.astype(np.int64), nodes - 1)
    share = x - k.astype(np.float32)
    f = []
    for phase in range(3):
        row = shape[phase if shape.shape[0] == 3 else 0]
        here = k if shape.shape[0] == 3 else (k + (nodes - nodes * phase // 3)) % nodes
        value = row[here] + (share * (row[here + 1] - row[here]))
        f.append(value if opened is None else np.where(opened == phase + 1, _ZERO, value))
    phases = Triple(*f)
    plane = clarke(SINGLE, phases)
    return Stationary(plane.x, plane.y, mean_of_phases(phases))


def reference_at(
    gains: Gains,
    f: Stationary,
    turn: Turn,
    torque: SingleArray,
    d: SingleArray,
    fade: SingleArray,
    zero: SingleArray,
) -> Stationary:
    """Currents in A that make a torque.

    Parameters
    ----------
    gains:
        With ``pole_pairs`` and ``psi_pm``.
    f:
        Shape in Wb.
    turn:
        Cosine and sine of the angle.
    torque:
        In N m.
    d:
        Constant current of the d axis in A.
    fade, zero:
        Shares of the shape beside its fundamental, and of its zero sequence.
    """
    fading, rest = fade < _ONE, (_ONE - fade) * gains["psi_pm"]
    alpha = np.where(fading, (fade * f.alpha) - (rest * turn[1]), f.alpha)
    beta = np.where(fading, (fade * f.beta) + (rest * turn[0]), f.beta)
    common = np.where(fading, fade * f.zero, f.zero)
    square = gains["pole_pairs"] * (
        (np.float32(1.5) * ((alpha * alpha) + (beta * beta)))
        + ((np.float32(3.0) * zero) * (common * common))
    )
    there = square > _LEAST_SQUARE
    scale = np.where(there, torque / np.where(there, square, _ONE), _ZERO)
    return Stationary(
        (scale * alpha) + (d * turn[0]), (scale * beta) + (d * turn[1]), scale * (zero * common)
    )


def largest_torque(
    nodes: tuple[SingleArray, SingleArray], torque: SingleArray, omega_e: SingleArray,
    v_dc: SingleArray,
) -> SingleArray:  # fmt: skip
    """Largest torque in N m between the nodes of a table.

    Parameters
    ----------
    nodes:
        Electrical speeds in rad/s and DC-link voltages in V, at least two each.
    torque:
        In N m, shape (speeds, voltages).
    omega_e, v_dc:
        Where, shape (N,).
    """
    places = []
    for axis, value in zip(nodes, (omega_e, v_dc), strict=True):
        k = np.zeros(value.shape, dtype=np.int64)
        for inner in axis[1:-1]:
            k = k + (value > inner)
        share = (value - axis[k]) / (axis[k + 1] - axis[k])
        places.append((k, np.where(share > _ONE, _ONE, np.where(share > _ZERO, share, _ZERO))))
    (j, x), (k, y) = places
    low = torque[j, k] + (y * (torque[j, k + 1] - torque[j, k]))
    high = torque[j + 1, k] + (y * (torque[j + 1, k + 1] - torque[j + 1, k]))
    return low + (x * (high - low))


def equal_load(
    omega_e: SingleArray, v_dc: SingleArray, v_nominal: np.float32, last: np.float32
) -> SingleArray:
    """Electrical speeds in rad/s that load the nominal link as much as these do the link there is,
    shape (N,).

    Parameters
    ----------
    omega_e, v_dc:
        Speeds in rad/s, positive, and voltages in V.
    v_nominal:
        Nominal link voltage in V.
    last:
        The speed in rad/s where there is no link.
    """
    there = v_dc > _ZERO
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = omega_e * (v_nominal / np.where(there, v_dc, _ONE))
    return np.asarray(np.where(there, scaled, last), dtype=np.float32)


def to_frame(frame: str, f: Stationary, x: Stationary, psi_pm: Any) -> Stationary:
    """Coordinates d, q and 0 of dqx or dqy, over its amplitude factor.

    Parameters
    ----------
    frame:
        ``dqx`` or ``dqy``.
    f:
        Shape in Wb.
    x:
        What is seen, in any unit.
    psi_pm:
        Flux of the fundamental in Wb.
    """
    scale = _ONE / psi_pm
    along = (f.alpha * x.alpha) + (f.beta * x.beta)
    across = (f.beta * x.alpha) - (f.alpha * x.beta)
    if frame == "dqx":
        return Stationary(scale * across, scale * along, x.zero)
    square, side, inverse = _side(f)
    length = np.sqrt(square + (np.float32(2.0) * (f.zero * f.zero)))
    return Stationary(
        scale * ((length * inverse) * across),
        scale * (along + (np.float32(2.0) * (f.zero * x.zero))),
        scale * (_ROOT_2 * (((f.zero * inverse) * along) - (side * x.zero))),
    )


def _side(f: Stationary) -> tuple[SingleArray, SingleArray, SingleArray]:
    """Square, length and its inverse of the shape in the plane."""
    square = (f.alpha * f.alpha) + (f.beta * f.beta)
    side = np.sqrt(square)
    there = side > _LEAST
    return square, side, np.where(there, _ONE / np.where(there, side, _ONE), _ZERO)


def from_frame(frame: str, f: Stationary, x: Stationary, psi_pm: Any) -> Stationary:
    """Stationary coordinates of what `to_frame` makes; arguments as there."""
    square, side, inverse = _side(f)
    whole = square if frame == "dqx" else square + (np.float32(2.0) * (f.zero * f.zero))
    there = whole > _LEAST_SQUARE
    scale = np.where(there, psi_pm / np.where(there, whole, _ONE), _ZERO)
    if frame == "dqx":
        return Stationary(
            scale * ((x.beta * f.alpha) + (x.alpha * f.beta)),
            scale * ((x.beta * f.beta) - (x.alpha * f.alpha)),
            x.zero,
        )
    across = (np.sqrt(whole) * inverse) * x.alpha
    along = x.beta + ((_ROOT_2 * (f.zero * inverse)) * x.zero)
    return Stationary(
        scale * ((along * f.alpha) + (across * f.beta)),
        scale * ((along * f.beta) - (across * f.alpha)),
        scale * ((x.beta * f.zero) - (_HALF_ROOT_2 * (side * x.zero))),
    )


def multiples_of(turn: Turn, orders: Sequence[int]) -> dict[int, Turn]:
    """Cosine and sine of multiples of an angle, ascending, by recurrence."""
    twice, x, reached, found = turned(turn, turn), turn, 1, {}
    for order in orders:
        for _ in range((order - reached) // 2):
            x = turned(x, twice)
        if (order - reached) % 2:
            x = turned(x, turn)
        reached, found[order] = order, x
    return found


def harmonic_share(gains: Gains, order: int, omega_e: SingleArray) -> SingleArray:
    """Share of a harmonic at an electrical speed in rad/s."""
    share = np.float32(5.0) - (gains["harmonic_fade"] * np.abs(np.float32(order) * omega_e))
    return np.where(share > _ONE, _ONE, np.where(share > _ZERO, share, _ZERO))


def signed_turn(multiples: Mapping[int, Turn], order: int) -> Turn:
    """Rotation of a signed order."""
    cosine, sine = multiples[abs(order)]
    return cosine, (-sine if order < 0 else sine)


def harmonic_gain(
    kp: Any, r_s: Any, reactance: SingleArray, now: Turn, acting: Turn
) -> tuple[SingleArray, SingleArray]:
    """What turns an integral into its voltage, real and imaginary part in V/A.

    Parameters
    ----------
    kp:
        Of the controller in V/A.
    r_s, reactance:
        Of the machine at the harmonic, in Ohm.
    now, acting:
        Multiples of the angles of the sample and of the voltage.
    """
    return (
        (kp * now[0]) + ((r_s * acting[0]) - (reactance * acting[1])),
        (kp * now[1]) + ((r_s * acting[1]) + (reactance * acting[0])),
    )
