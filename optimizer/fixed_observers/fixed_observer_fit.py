"""The position observer of a design in integers, with its evidence."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Annotated, Any

from dqforge.machines.design.design import Design
from dqforge.machines.design.numerical import on_design
from dqforge.machines.dq_machines.synchronous import linearised
from dqforge.machines.errors import InputError, NoSolutionError
from dqforge.machines.names import NumberFormat
from dqforge.machines.records import dataclass
from dqforge.machines.transforms import N, Pair
from dqforge.optimizer.current_reference.forms import FIXED_WIDTHS
from dqforge.optimizer.fixed_control.codes import TurnSteps, rotation, sine_error, turn_steps
from dqforge.optimizer.fixed_control.design import require_scales
from dqforge.optimizer.fixed_control.ranges import codes, require
from dqforge.optimizer.fixed_observers import (
    fixed_ekf,
    fixed_extended_emf,
    fixed_matsui_voltage,
    fixed_smo,
)
from dqforge.optimizer.fixed_observers import fixed_sampled_machine as fixed_matsui_current
from dqforge.optimizer.fixed_observers import kit as fixed_open_loop_flux
from dqforge.optimizer.fixed_observers.kit import (
    NARROW,
    TOP,
    WIDTH,
    FixedCurrentModel,
    FixedFluxPath,
    FixedMethod,
    FixedPll,
    Scales,
    TrackedState,
    active_angle,
    clipped,
    code_limits,
    corrected,
    fixed_current_model,
    fixed_flux_path,
    flux_floor,
    gain,
    integrated,
    model_flux,
    predicted,
    shown,
    speed_size,
    vector_words,
    widened,
)
from dqforge.optimizer.loops.integer_gains import FixedGain
from dqforge.optimizer.observers.methods.flux_gains import FluxGains
from dqforge.optimizer.observers.tuning import PositionObserver
from dqforge.optimizer.steps.integer_arithmetic import (
    Arithmetic,
    Range,
    Ranges,
    Reach,
    rounded,
    scaled,
)
from dqforge.optimizer.steps.step_arithmetic import Member


@dataclass(frozen=True, slots=True)
class FixedPositionObserver:
    """What ``<prefix>_observer_q15.h`` holds: method, integers, and bits of a code of the control;
    full scales of current in A, voltage in V and mechanical speed in rad/s; angle in rad by which
    the drive turns in a period at full speed.
    """

    method: FixedMethod
    gains: Any
    width: int
    bases: tuple[float, float, float]
    turn: float

    @property
    def format(self) -> NumberFormat:
        """Name of the number format."""
        return "q15" if self.width == 16 else "q31"


@dataclass(frozen=True, slots=True)
class FixedObserverFit:
    """A position observer in integers with its evidence.

    Args:
        observer: The integers.
        reaches: Proven range of every product and sum.
        sine_error: Largest error of sine and cosine in codes of 32 bits.
    """

    observer: FixedPositionObserver
    reaches: tuple[Reach, ...]
    sine_error: float

    @property
    def fullest(self) -> Reach:
        """The quantity that comes nearest to its word's end."""
        return max(self.reaches, key=lambda reach: reach.share)

    @property
    def sine(self) -> TurnSteps:
        """Integers of sine and cosine."""
        return turn_steps(WIDTH)

    @property
    def angle_step(self) -> float:
        """What one code of the angle is, in rad."""
        return float(2.0 * math.pi / 2**self.observer.width)

    @property
    def speed_step(self) -> float:
        """What one code of the mechanical speed is, in rad/s."""
        return float(self.observer.bases[2] / 2 ** (self.observer.width - 1))


def fit_observer(design: Design, observer: PositionObserver, width: int) -> FixedObserverFit:
    """A position observer in integers behind a control of 16 or 32 bits.

    Args:
        design: Machine and bases.
        observer: The observer that was tuned.
        width: Bits of a code of the control.

    Raises:
        InputError: The bases do not hold the largest current or speed, or the method is not there
            in integers.
        NoSolutionError: A quantity can overflow, or a gain has no format.
    """
    require_scales(design)
    method, bases = fixed_method_named(observer.method.name), design.control.bases
    scales = Scales(
        current=bases.current,
        voltage=bases.voltage,
        speed=bases.speed * design.machine.pole_pairs,
        t_s=observer.t_s,
        machine=linearised(design.machine),
    )
    gains = method.design(observer.gains, scales)
    found = FixedPositionObserver(
        method, gains, width, (bases.current, bases.voltage, bases.speed), scales.turn
    )
    return FixedObserverFit(found, observer_reaches(method, gains, width), sine_error(WIDTH))


@on_design("export.control")
def solve_fixed_observers(
    design: Design, observer: PositionObserver | None
) -> tuple[FixedObserverFit, ...]:
    """The position observer in every fixed-point format that the design asks for.

    Errors as `fit_observer`.
    """
    if observer is None:
        return ()
    widths = [FIXED_WIDTHS[name] for name in design.export.control if name in FIXED_WIDTHS]
    return tuple(fit_observer(design, observer, width) for width in widths)


# Flux observer in integers (`dqforge.optimizer.observers.methods.flux`).

SHARE_BITS = 30  # Fractional bits of the share of the current model.
ALL = 1 << SHARE_BITS  # The whole of the current model.


@dataclass(frozen=True, slots=True)
class FixedFlux:
    """Flux observer in integers."""

    path: FixedFluxPath
    model: FixedCurrentModel
    alpha_0: Annotated[int, Member("share of the current model at rest, 2^30 codes of 1")]
    alpha_1: Annotated[FixedGain, Member("and by the speed")]
    floor: Annotated[int, Member("least active flux linkage that counts in full, of 16 bits")]
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
    turn = o.let("turn", o.call(rotation, WIDTH, state.theta))
    psi = o.let("psi", o.call(model_flux, gains.model, i, turn))
    return TrackedState(state.theta, state.omega, (psi.x, psi.y, i.x, i.y))


def pulled(o: Arithmetic[N, Any], alpha: N, own: N, model: N) -> N:
    """A flux linkage pulled by a share, 2^30 codes of 1, towards that of the current model."""
    gap = o.total("model - flux", model, o.negative(own))
    part = o.call(rounded, "alpha gap", o.product("alpha gap", alpha, gap), SHARE_BITS)
    return o.call(clipped, o.total("corrected flux", own, part))


def step(
    o: Arithmetic[N, Any], gains: FixedFlux, state: TrackedState[N], v: Pair[N], i: Pair[N]
) -> TrackedState[N]:
    """One sample: v acted over the period that ends at the sampling instant of i; both in codes of
    the control.
    """
    before, last = Pair(*state.words[:2]), Pair(*state.words[2:])
    theta_p = o.let("theta", o.call(predicted, gains.pll.advance, state.theta, state.omega))
    turn = o.let("turn", o.call(rotation, WIDTH, theta_p))
    own = o.let("own", o.call(integrated, gains.path, before, v, last, i, state.omega))
    model = o.let("model", o.call(model_flux, gains.model, i, turn))
    size = o.call(speed_size, state.omega)
    by_speed = o.call(scaled, "alpha_1 omega", gains.alpha_1, size)
    share = o.total("alpha", by_speed, o.const(gains.alpha_0))
    alpha = o.let("alpha", o.clamp(share, -ALL, ALL))
    psi = o.let(
        "psi",
        Pair(o.call(pulled, alpha, own.x, model.x), o.call(pulled, alpha, own.y, model.y)),
    )
    error = o.let("error", o.call(active_angle, gains.model, psi, i, turn, gains.floor))
    theta, omega = corrected(o, gains.pll, theta_p, state.omega, error)
    return TrackedState(theta, omega, (psi.x, psi.y, i.x, i.y))


METHOD = FixedMethod(
    name="flux",
    code="flux",
    gains=FixedFlux,
    design=design,
    words=vector_words(psi="stator flux linkage", i="last current"),
    limits=code_limits(4),
    begin=begin,
    step=step,
)


# What the integers of an observer can become: proof that nothing overflows, for any inputs and any
# past.
#
# The step runs on ranges in place of numbers, from every angle, every speed and all that the words
# of the state are said to hold. What it leaves must lie within the same ranges: so they hold for
# every number of samples.


def observer_reaches(method: FixedMethod, gains: Any, width: int) -> tuple[Reach, ...]:
    """Range of every named product and sum of the emitted functions, in the order of evaluation.

    Args:
        method, gains: The observer.
        width: Bits of a code of the control.

    Raises:
        NoSolutionError: A quantity can leave its word, or a state its range; the message names it.
    """
    every, angle = codes(width), Range(0, 2**width - 1)
    found: dict[str, Reach] = {}
    speed = Range(-TOP - 1, TOP)
    for name, function in (("begin", method.begin), ("step", method.step)):
        o = Ranges(WIDTH, f"{name}: ")
        x = widened(o, "voltage or current", every, width)
        vector = Pair(x, x)
        before = TrackedState(Range(0, 2**WIDTH - 1), speed, method.limits(gains))
        after = function(o, gains, before, vector, vector)
        shown(o, after, width)
        widened(o, "angle or speed of the start", angle, width)
        widened(o, "angle or speed of the start", every, width)
        _require_closed(method, gains, after)
        o.reaches = {key: _in_its_word(reach) for key, reach in o.reaches.items()}
        require(o)
        found |= o.reaches
    return tuple(found.values())


def _in_its_word(reach: Reach) -> Reach:
    """What the C divides in 32 bits must fit these."""
    return replace(reach, bits=WIDTH) if NARROW in reach.name else reach


def _require_closed(method: FixedMethod, gains: Any, after: TrackedState[Range]) -> None:
    """Refuse a step that leaves the ranges from which it was taken."""
    limits = {
        "theta": (after.theta, Range(0, 2**WIDTH - 1)),
        "omega": (after.omega, Range(-TOP - 1, TOP)),
    }
    named = zip(method.words, after.words, method.limits(gains), strict=True)
    limits |= {word.name: (is_, may) for word, is_, may in named}
    for name, (is_, may) in limits.items():
        if is_.low < may.low or is_.high > may.high:
            raise NoSolutionError(
                f"fixed point: '{name}' of the observer can reach {is_.largest}, beyond "
                f"{may.largest}; use larger bases in control.per_unit"
            )


# The position observers that there are in integers, by name.

# The methods by name.
FIXED_METHODS: Mapping[str, FixedMethod] = MappingProxyType(
    {
        method.name: method
        for method in (
            fixed_extended_emf.METHOD,
            fixed_smo.METHOD,
            METHOD,
            fixed_open_loop_flux.METHOD,
            fixed_matsui_voltage.METHOD,
            fixed_matsui_current.METHOD,
            fixed_ekf.METHOD,
        )
    }
)


def fixed_method_named(name: str) -> FixedMethod:
    """The method of that name.

    Raises:
        InputError: It is not there in integers.
    """
    if name not in FIXED_METHODS:
        raise InputError(
            f"export.control: the observer {name} is not there in fixed point; write "
            "export.control: float32, or one of the observers "
            f"{', '.join(FIXED_METHODS)}"
        )
    return FIXED_METHODS[name]
