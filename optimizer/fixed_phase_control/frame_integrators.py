"""Integrators in dq0, dqx and dqy without angles: errors and voltages along the flux.

In dqx and dqy of paper 002 quantities are divided by a = c / |f|. An axis b of length |f| then sees
b'e and makes I b / |f|^2, so that neither a root nor an angle of dqx is needed. The inner product
counts the zero sequence twice, as the mean of the phases asks for.
"""

from __future__ import annotations

import math
from typing import Any

from dqforge.machines.transforms import N, Triple, park, park_inverse
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, rounded
from dqforge.optimizer.fixed_control.transforms import Codes, rotation
from dqforge.optimizer.fixed_phase_control.integers import FixedPhaseControl, Vector

Vectors = tuple[N, N, N]


def frame_errors(
    o: Arithmetic[N, Any],
    control: FixedPhaseControl,
    error: tuple[N, ...],
    electrical: N,
    flux: Vector[N],
) -> Triple[N]:
    """Errors on the axes of the frame, in codes; flux and angle are those of the sample."""
    codes = Codes(o, control.width)
    if control.frame in ("dq", "table"):
        pair = park(codes, (error[0], error[1]), rotation(o, control.width, electrical))
        return Triple(pair.x, pair.y, error[2])
    found = []
    for axis in frame_axes(o, control, flux):
        terms = [
            o.shifted(o.product("frame: error", part, value), 2)
            for part, value in zip(axis, error, strict=True)
        ]
        total = o.total("frame: error", *terms, terms[2])
        found.append(codes.saturated(rounded(o, "frame: error", total, control.width - 3)))
    return Triple(*found)


def frame_voltage(
    o: Arithmetic[N, Any],
    control: FixedPhaseControl,
    integral: Triple[N],
    acting: tuple[N, N],
    flux: Vector[N],
) -> Vectors[N]:
    """Voltage of the integrals in codes, at the angle at which it acts.

    ``acting`` are the angle of the shape and the electrical angle there, ``flux`` is that there.
    """
    codes = Codes(o, control.width)
    held = [
        o.const(0)
        if axis is None
        else codes.saturated(rounded(o, "integral", value, axis.fraction))
        for value, axis in zip(integral, (control.d, control.q, control.zero), strict=True)
    ]
    if control.frame in ("dq", "table"):
        turn = rotation(o, control.width, acting[1])
        pair = park_inverse(codes, (held[0], held[1]), turn)
        return pair.x, pair.y, held[2]
    bits = control.width - 1
    square = axis_square(o, control, flux)
    parts = [
        codes.saturated(
            o.quotient(
                "frame: I / |f|^2", o.product("frame: I", x, o.const(1 << (bits - 1))), square
            )
        )
        for x in held
    ]
    axes = frame_axes(o, control, flux)
    found = [
        codes.saturated(
            rounded(
                o,
                "frame: voltage",
                o.total(
                    "frame: voltage",
                    *(
                        o.shifted(o.product("frame: voltage", part, axis[place]), 1)
                        for part, axis in zip(parts, axes, strict=True)
                    ),
                ),
                bits - 2,
            )
        )
        for place in range(3)
    ]
    return found[0], found[1], found[2]


def axis_square(o: Arithmetic[N, Any], control: FixedPhaseControl, flux: Vector[N]) -> N:
    """Square of the length of the axes in codes: of the flux in the plane, in dqy of all of it."""
    bits = control.width - 1
    squares = [o.shifted(o.product("frame: square", x, x), bits) for x in flux]
    terms = squares[:2] if control.frame == "dqx" else [*squares, squares[2]]
    return o.clamp(o.total("frame: square", *terms), control.least_square, 4 << bits)


def frame_axes(
    o: Arithmetic[N, Any], control: FixedPhaseControl, flux: Vector[N]
) -> tuple[Vectors[N], Vectors[N], Vectors[N]]:
    """Axes d, q and 0 of dqx or dqy, each as long as the flux, in codes."""
    none = o.const(0)
    across: Vectors[N] = (flux.beta, o.negative(flux.alpha), none)
    if control.frame == "dqx":
        return across, (flux.alpha, flux.beta, none), (none, none, none)
    codes, bits = Codes(o, control.width), control.width - 1
    quarter = [o.shifted(o.product("frame: length", x, x), 2) for x in flux]
    plane = o.total("frame: length", quarter[0], quarter[1])
    whole = o.total("frame: length", plane, quarter[2], quarter[2])
    end = (1 << (2 * bits + 1)) - 1
    half_plane = o.clamp(o.root(o.clamp(plane, 0, end)), 1, 2 << bits)
    half_whole = o.root(o.clamp(whole, 0, end))
    # Ratios in codes of one half, since they may pass 1.
    longer = codes.saturated(
        o.quotient(
            "frame: |f| / plane",
            o.product("frame: |f|", o.clamp(half_whole, 0, 1 << bits), o.const(1 << (bits - 1))),
            half_plane,
        )
    )
    steep = codes.saturated(
        o.quotient(
            "frame: zero / plane",
            o.product("frame: zero", flux.zero, o.const(1 << (bits - 2))),
            half_plane,
        )
    )

    def doubled(name: str, a: N, b: N) -> N:
        return codes.saturated(rounded(o, name, o.product(name, a, b), bits - 1))

    d: Vectors[N] = (
        doubled("frame: d", across[0], longer),
        doubled("frame: d", across[1], longer),
        none,
    )
    root_half = o.const(round(2**bits * math.sqrt(0.5)))
    inclined = [doubled("frame: 0", x, steep) for x in (flux.alpha, flux.beta)]
    # sqrt 2 times, as twice the product with its half.
    zero: Vectors[N] = (
        doubled("frame: 0", inclined[0], root_half),
        doubled("frame: 0", inclined[1], root_half),
        o.negative(
            codes.settled(
                "frame: 0",
                o.product(
                    "frame: 0", o.clamp(_twice(o, half_plane), 0, (1 << bits) - 1), root_half
                ),
            )
        ),
    )
    return d, (flux.alpha, flux.beta, flux.zero), zero


def _twice(o: Arithmetic[N, Any], a: N) -> N:
    return o.product("frame: plane", o.const(2), a)
