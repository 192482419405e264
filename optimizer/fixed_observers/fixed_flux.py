"""Flux observer in integers (`dqforge.optimizer.observers.methods.flux`)."""

from __future__ import annotations

from typing import Any

from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, rounded
from dqforge.optimizer.fixed_control.gains import scaled
from dqforge.optimizer.fixed_control.transforms import rotation
from dqforge.optimizer.fixed_observers.fixed_method import (
    FixedMethod,
    TrackedState,
    code_limits,
    vector_words,
)
from dqforge.optimizer.fixed_observers.fixed_voltage_model import (
    FixedCurrentModel,
    FixedFluxPath,
    active_angle,
    fixed_current_model,
    fixed_flux_path,
    flux_floor,
    integrated,
    model_flux,
)
from dqforge.optimizer.fixed_observers.kit import (
    WIDTH,
    FixedPll,
    corrected,
    difference,
    predicted,
    saturated,
    speed_size,
)
from dqforge.optimizer.fixed_observers.scales import Scales, gain
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.methods.flux_gains import FluxGains

SHARE_BITS = 30  # Fractional bits of the share of the current model.
ALL = 1 << SHARE_BITS  # The whole of the current model.


@dataclass(frozen=True, slots=True)
class FixedFlux:
    """Voltage and current model, share of the latter (2^30 codes of 1) at rest and by the speed,
    least active flux linkage in codes of 16 bits, loop.
    """

    path: FixedFluxPath
    model: FixedCurrentModel
    alpha_0: int
    alpha_1: FixedGain
    floor: int
    pll: FixedPll


def design(gains: FluxGains, scales: Scales) -> FixedFlux:
    """The observer in integers.

    Args:
        gains: Those in double precision.
        scales: Full scales of the control.
    """
    return FixedFlux(
        path=fixed_flux_path(gains.path, scales),
        model=fixed_current_model(gains.l_d, gains.l_q, gains.psi_pm, scales),
        alpha_0=round(gains.alpha_0 * 2**SHARE_BITS),
        alpha_1=gain("share by the speed", 0.5 * gains.alpha_1 * scales.turn),
        floor=flux_floor(gains.floor, scales),
        pll=scales.pll(gains.pll),
    )


def begin(
    o: Arithmetic[N, Any], gains: FixedFlux, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """The flux linkage of the current model."""
    del v
    psi = model_flux(o, gains.model, i, rotation(o, WIDTH, state.theta))
    return TrackedState(state.theta, state.omega, (psi.x, psi.y, i.x, i.y))


def step(
    o: Arithmetic[N, Any], gains: FixedFlux, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """One sample: ``v`` acted over the period that ends at the sampling instant of ``i``."""
    before, last = Pair(*state.words[:2]), Pair(*state.words[2:])
    theta_p = predicted(o, gains.pll.advance, state.theta, state.omega)
    turn = rotation(o, WIDTH, theta_p)
    psi = integrated(o, gains.path, before, v, (last, i), state.omega)
    model = model_flux(o, gains.model, i, turn)
    by_speed = scaled(o, "alpha_1 omega", gains.alpha_1, speed_size(o, state.omega))
    alpha = o.clamp(o.total("alpha", by_speed, o.const(gains.alpha_0)), -ALL, ALL)
    gap = difference(o, "model - flux", model, psi)

    def pulled(own: N, apart: N) -> N:
        part = rounded(o, "alpha gap", o.product("alpha gap", alpha, apart), SHARE_BITS)
        return saturated(o, o.total("corrected flux", own, part))

    psi = Pair(pulled(psi.x, gap.x), pulled(psi.y, gap.y))
    error = active_angle(o, gains.model, psi, i, turn, gains.floor)
    theta, omega = corrected(o, gains.pll, theta_p, state.omega, error)
    return TrackedState(theta, omega, (psi.x, psi.y, i.x, i.y))


METHOD = FixedMethod(
    name="flux",
    code="flux",
    gains=FixedFlux,
    design=design,
    words=vector_words("psi", "i"),
    limits=code_limits(4),
    begin=begin,
    step=step,
)
