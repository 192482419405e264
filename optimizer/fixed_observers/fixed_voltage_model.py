"""Voltage model of the stator flux linkage in integers, and the angle of its active part."""

from __future__ import annotations

from typing import Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair, park, park_inverse
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic
from dqforge.optimizer.fixed_control.gains import scaled
from dqforge.optimizer.fixed_control.transforms import Codes
from dqforge.optimizer.fixed_observers.kit import (
    ONE,
    WIDTH,
    difference,
    saturated,
    saturated_pair,
    scaled_pair,
    sine_of_angle,
    times,
)
from dqforge.optimizer.fixed_observers.scales import Scales, code, gain, size_floor
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.methods.flux_gains import FluxPath

_TWO_CODES = 2 * ONE


@dataclass(frozen=True, slots=True)
class FixedFluxPath:
    """Gains to codes of the flux linkage: of the voltage, of the sum of two currents, of their
    difference by L_q, and both parts of the end correction.
    """

    volt: FixedGain
    half_drop: FixedGain
    l_q: FixedGain
    end_drop: FixedGain
    end_turn: FixedGain


@dataclass(frozen=True, slots=True)
class FixedCurrentModel:
    """Inductances from codes of the current to those of the flux linkage, and the magnet's."""

    l_d: FixedGain
    l_q: FixedGain
    psi_pm: int


def fixed_flux_path(path: FluxPath, scales: Scales) -> FixedFluxPath:
    """The voltage model in integers.

    Args:
        path: In double precision.
        scales: Full scales of the control.
    """
    current = scales.current / scales.flux
    return FixedFluxPath(
        volt=gain("flux of a voltage", path.t_s * scales.voltage / scales.flux),
        half_drop=gain("flux of a voltage drop", path.half_drop * current, _TWO_CODES),
        l_q=gain("L_q", path.l_q * current, _TWO_CODES),
        end_drop=gain("end correction", path.end * path.drop * current, _TWO_CODES),
        end_turn=gain("end correction", path.end * scales.turn),
    )


def fixed_current_model(l_d: float, l_q: float, psi_pm: float, scales: Scales) -> FixedCurrentModel:
    """The current model in integers, from inductances in H and the magnet flux linkage in V s."""
    current = scales.current / scales.flux
    return FixedCurrentModel(
        gain("L_d", l_d * current), gain("L_q", l_q * current), code("psi_pm", psi_pm / scales.flux)
    )


def flux_floor(floor: float, scales: Scales) -> int:
    """Least active flux linkage that counts in full, ``floor`` in V s, in codes of 16 bits."""
    return size_floor(floor / scales.flux)


def model_flux(
    o: Arithmetic[N, Any], model: FixedCurrentModel, i: Pair[N], turn: Pair[N]
) -> Pair[N]:
    """Flux linkage (alpha, beta) of the current model."""
    codes = Codes(o, WIDTH)
    current = park(codes, i, turn)
    along = o.total(
        "flux of the d axis", scaled(o, "l_d i_d", model.l_d, current.x), o.const(model.psi_pm)
    )
    across = saturated(o, scaled(o, "l_q i_q", model.l_q, current.y))
    return park_inverse(codes, Pair(saturated(o, along), across), turn)


def integrated(
    o: Arithmetic[N, Any],
    path: FixedFluxPath,
    psi: Pair[N],
    v: Pair[N],
    currents: tuple[Pair[N], Pair[N]],
    omega: N,
) -> Pair[N]:
    """Flux linkage after a period by the voltage model; ``currents`` before and after it."""
    last, i = currents
    both = Pair(o.total("both currents", last.x, i.x), o.total("both currents", last.y, i.y))
    volts = scaled_pair(o, "flux of the voltage", path.volt, v)
    drop = scaled_pair(o, "flux of the drop", path.half_drop, both)
    first = difference(o, "v - R i", volts, drop)
    change = difference(o, "change of the current", i, last)
    own = scaled_pair(o, "l_q change", path.l_q, change)
    turning = saturated_pair(o, difference(o, "turning flux", first, own))
    turned = Pair(
        times(o, "omega turning", omega, turning.x), times(o, "omega turning", omega, turning.y)
    )
    end = scaled_pair(o, "end: drop", path.end_drop, change)
    around = scaled_pair(o, "end: turn", path.end_turn, turned)
    return Pair(
        saturated(o, o.total("flux", psi.x, first.x, o.negative(end.x), around.y)),
        saturated(o, o.total("flux", psi.y, first.y, o.negative(end.y), o.negative(around.x))),
    )


def active_angle(
    o: Arithmetic[N, Any],
    model: FixedCurrentModel,
    psi: Pair[N],
    i: Pair[N],
    turn: Pair[N],
    floor: int,
) -> N:
    """Sine of the angle from the direction ``turn`` to the active flux psi - l_q i."""
    own = scaled_pair(o, "l_q i", model.l_q, i)
    active = saturated_pair(o, difference(o, "active flux", psi, own))
    across = park(Codes(o, WIDTH), active, turn).y
    return sine_of_angle(o, across, active, floor)
