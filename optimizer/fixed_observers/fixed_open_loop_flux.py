"""Open-loop flux estimator in integers (`dqforge.optimizer.observers.methods.open_loop_flux`)."""

from __future__ import annotations

from typing import Any

from dqforge.machines.errors import NoSolutionError
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair
from dqforge.optimizer.fixed_control.arithmetic import Arithmetic, larger, rounded
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
    ONE,
    WIDTH,
    FixedPll,
    corrected,
    predicted,
    quotient,
    saturated,
    speed_size,
    times,
    with_sign_of,
)
from dqforge.optimizer.fixed_observers.polynomials import (
    FixedPolynomials,
    common_scale,
    value_of,
)
from dqforge.optimizer.fixed_observers.scales import Scales, gain
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.methods.open_loop_flux import OpenLoopFluxGains

BITS = 25  # Fractional bits of the factor c of the filter, which stays below 2^(30 - 25).
LARGEST = 1 << (WIDTH - 2)  # Limit of both parts of c in codes.
_MOST_CORNER = 1 << 36
_SHARE_BITS = 30


@dataclass(frozen=True, slots=True)
class FixedOpenLoop:
    """Voltage and current model; corner kappa of the filter over the angle of a period at full
    speed: by the speed (``corner``), and the least (``least``), codes of 2^31; half of kappa from
    there; least speed; half cotangent times x; least active flux linkage; loop.
    """

    path: FixedFluxPath
    model: FixedCurrentModel
    corner: FixedGain
    least: int
    half: FixedGain
    slowest: int
    cotangent: FixedPolynomials
    floor: int
    pll: FixedPll


def design(gains: OpenLoopFluxGains, scales: Scales) -> FixedOpenLoop:
    """The estimator in integers.

    Args:
        gains: Those in double precision.
        scales: Full scales of the control.

    Raises:
        NoSolutionError: A gain has no format, or the corner of the filter is beyond that of any
            speed.
    """
    x = scales.turn
    least = round(gains.kappa_0 / x * ONE)
    if max(least, gains.kappa_1 * ONE) > _MOST_CORNER:
        raise NoSolutionError(
            "fixed point: observer, the filter's corner is more than 32 times the full scale of "
            "the speed; use a larger base in control.per_unit.speed"
        )
    series = [1.0, -(x**2) / 12.0, -(x**4) / 720.0]
    return FixedOpenLoop(
        path=fixed_flux_path(gains.path, scales),
        model=fixed_current_model(gains.l_d, gains.l_q, gains.psi_pm, scales),
        corner=gain("corner by the speed", gains.kappa_1),
        least=least,
        half=gain("half of kappa", 0.5 * x * 2**BITS / ONE, _MOST_CORNER),
        slowest=max(1, round(gains.x_min / x * ONE)),
        cotangent=common_scale("half cotangent", [series], _SHARE_BITS),
        floor=flux_floor(gains.floor, scales),
        pll=scales.pll(gains.pll),
    )


def _factor(o: Arithmetic[N, Any], gains: FixedOpenLoop, omega: N) -> tuple[Pair[N], N]:
    """Real and imaginary part of c, and half of kappa, in codes of 2^BITS."""
    size = speed_size(o, omega)
    kappa = larger(o, scaled(o, "corner", gains.corner, size), o.const(gains.least))
    slow = o.clamp(size, gains.slowest, ONE)
    half = scaled(o, "half of kappa", gains.half, kappa)
    over = quotient(o, "kappa / x", kappa, slow, BITS)
    # The angle of a period enters the series as the speed does: its square is one of codes.
    share = value_of(o, gains.cotangent.rows[0], times(o, "square of the speed", slow, slow))
    part = rounded(
        o, "half cotangent", o.product("half cotangent", share, over), gains.cotangent.shift
    )
    imaginary = o.clamp(part, -LARGEST, LARGEST)
    real = o.clamp(o.total("1 + kappa / 2", o.const(1 << BITS), half), -LARGEST, LARGEST)
    return Pair(real, o.negative(with_sign_of(o, omega, imaginary))), half


def begin(
    o: Arithmetic[N, Any], gains: FixedOpenLoop, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """The flux linkage of the current model, as the filter would have it: psi conj(c) / |c|^2."""
    del v
    c, _ = _factor(o, gains, state.omega)
    psi = model_flux(o, gains.model, i, rotation(o, WIDTH, state.theta))
    square = o.total("|c|^2", o.product("|c|^2", c.x, c.x), o.product("|c|^2", c.y, c.y))
    size = o.clamp(o.shifted(square, BITS), 1, 1 << (2 * WIDTH - 2))
    first = o.total(
        "conj(c) psi", o.product("conj(c) psi", c.x, psi.x), o.product("conj(c) psi", c.y, psi.y)
    )
    second = o.total(
        "conj(c) psi",
        o.product("conj(c) psi", c.x, psi.y),
        o.negative(o.product("conj(c) psi", c.y, psi.x)),
    )
    filtered = (
        saturated(o, o.quotient("psi / c", first, size)),
        saturated(o, o.quotient("psi / c", second, size)),
    )
    return TrackedState(state.theta, state.omega, (*filtered, i.x, i.y))


def step(
    o: Arithmetic[N, Any], gains: FixedOpenLoop, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """One sample: ``v`` acted over the period that ends at the sampling instant of ``i``."""
    before, last = Pair(*state.words[:2]), Pair(*state.words[2:])
    c, half = _factor(o, gains, state.omega)
    theta_p = predicted(o, gains.pll.advance, state.theta, state.omega)
    turn = rotation(o, WIDTH, theta_p)
    psi = integrated(o, gains.path, before, v, (last, i), state.omega)
    one = o.const(1 << BITS)
    keep = quotient(o, "1 / (1 + kappa)", one, o.total("1 + kappa", one, half, half), _SHARE_BITS)

    def kept(own: N) -> N:
        return rounded(o, "kept flux", o.product("kept flux", keep, own), _SHARE_BITS)

    filtered = Pair(kept(psi.x), kept(psi.y))
    real = o.total(
        "c psi",
        o.product("c psi", c.x, filtered.x),
        o.negative(o.product("c psi", c.y, filtered.y)),
    )
    imaginary = o.total(
        "c psi", o.product("c psi", c.x, filtered.y), o.product("c psi", c.y, filtered.x)
    )
    psi = Pair(
        saturated(o, rounded(o, "c psi", real, BITS)),
        saturated(o, rounded(o, "c psi", imaginary, BITS)),
    )
    error = active_angle(o, gains.model, psi, i, turn, gains.floor)
    theta, omega = corrected(o, gains.pll, theta_p, state.omega, error)
    return TrackedState(theta, omega, (filtered.x, filtered.y, i.x, i.y))


METHOD = FixedMethod(
    name="open-loop-flux",
    code="open_loop_flux",
    gains=FixedOpenLoop,
    design=design,
    words=vector_words("psi", "i"),
    limits=code_limits(4),
    begin=begin,
    step=step,
)
